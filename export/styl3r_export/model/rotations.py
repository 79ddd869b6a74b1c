"""Rotations as unit quaternions w x y z, and rigid motions."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor


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


def rotation_matrix(q: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation matrices of unit quaternions w x y z."""
    w, x, y, z = q.unbind(-1)
    rows = (
        1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
        2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
        2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))


def full_precision(x: Tensor) -> AbstractContextManager[None]:
    """Keep autocast away: solving for cameras in half precision would lose them."""
    if torch.is_autocast_enabled(x.device.type):
        return torch.autocast(x.device.type, enabled=False)
    return nullcontext()
