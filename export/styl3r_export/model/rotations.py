"""Rotations as unit quaternions w x y z, and rigid motions."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F


class Motion(NamedTuple):
    """World (first view) to camera: X_i = R(rotation) X_0 + translation."""

    rotation: Float[Tensor, "pairs 4"]
    translation: Float[Tensor, "pairs 3"]


def rotate_vectors(q: Float[Tensor, "*batch 4"], v: Float[Tensor, "*batch 3"]) -> Tensor:
    """Rotate vectors by unit quaternions w x y z (broadcasting)."""
    w, axis = q[..., :1], q[..., 1:]
    axis, v = torch.broadcast_tensors(axis, v)
    t = 2 * torch.linalg.cross(axis, v)
    return v + w * t + torch.linalg.cross(axis, t)


def multiply_quaternions(a: Float[Tensor, "*batch 4"], b: Float[Tensor, "*batch 4"]) -> Tensor:
    """Hamilton product, w x y z: first b, then a."""
    aw, ax, ay, az = a.unbind(-1)
    bw, bx, by, bz = b.unbind(-1)
    return torch.stack(
        (
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ),
        dim=-1,
    )


# The product's table: [i, j] is the product of the i-th and the j-th unit, w x y z.
UNITS = multiply_quaternions(torch.eye(4)[:, None], torch.eye(4))
# Matrices of the cross product with each axis, the axes last.
SKEW = torch.linalg.cross(torch.eye(3)[:, None], torch.eye(3)[None]).transpose(0, 2)


def turn(q: Float[Tensor, "n 4"], by: Float[Tensor, "n 3"]) -> Float[Tensor, "n 4"]:
    """Unit quaternions turned by small rotation vectors (few operators: for a solver's loop)."""
    half = F.pad(by / 2, (1, 0), value=1.0)
    each = half[:, :, None, None] * (q[:, None, :, None] * UNITS.to(q))
    turned = each.sum(dim=(1, 2))
    return turned / turned.norm(dim=-1, keepdim=True)


def skew(v: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Cross-product matrices."""
    return (v[..., None, None, :] * SKEW.to(v)).sum(dim=-1)


def rotation_matrix(q: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation matrices of unit quaternions w x y z: I + 2 w [v]x + 2 [v]x [v]x."""
    axis = skew(q[..., 1:])
    return torch.eye(3, device=q.device) + 2 * (q[..., :1, None] * axis + axis @ axis)


def full_precision(x: Tensor) -> AbstractContextManager[None]:
    """Keep autocast away: solving for cameras in half precision would lose them."""
    if torch.is_autocast_enabled(x.device.type):
        return torch.autocast(x.device.type, enabled=False)
    return nullcontext()
