"""Linearised reprojection errors of matches, and their inverse depths eliminated."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from styl3r_export.model.rotations import SKEW

# A projected point must stay in front of the camera by this (homogeneous) depth.
FRONT = 0.1
# d(y)/d(turn, shift) of a point y = s + rho t: -[s]x and rho I, as products with (s, rho).
BY_POSE = torch.cat((F.pad(-SKEW, (0, 1)), F.pad(torch.eye(3)[..., None], (3, 0))), dim=1)


class Cells(NamedTuple):
    """Cells of both sides, the cells last: runtimes are slow on axes of two or three."""

    rays: Float[Tensor, "2*pairs 3 cells"]  # (x/z, y/z, 1)
    matched: Float[Tensor, "2*pairs 2 cells"]  # ray of the match in the other view
    weight: Float[Tensor, "2*pairs 1 cells"]  # of a match that is no outlier: 1 / variance
    prior: Float[Tensor, "2*pairs 1 cells"]  # inverse depth
    stiffness: Float[Tensor, "2*pairs 1 cells"]  # weight of the prior
    # Derivative of rho's distance from the prior by the log scale of depth, where that is free.
    by_scale: Float[Tensor, "2*pairs 1 cells"] | None


def linearise(
    rotation: Float[Tensor, "2*pairs 3 3"],
    translation: Float[Tensor, "2*pairs 3 1"],
    cells: Cells,
    rho: Float[Tensor, "2*pairs 1 cells"],
    outlier: float | Tensor,
) -> tuple[Float[Tensor, "2*pairs 3 columns cells"], Float[Tensor, "2*pairs 3 1 cells"]]:
    """Three equations a cell, and their weights: where it is seen (x and y), and its depth's prior.

    With inverse depth rho a cell's point in the other view is y = R r + rho t, linear in rho and
    defined at infinity. The first two equations are multiplied by its depth z and their weights
    divided by the square, which spares divisions: z d(y_xy / z) is d(y_xy) - (y_xy / z) d(z).

    Returns:
        Columns: derivatives by the side's own turn and shift (and its depths' log scale), the
        residual itself, and the derivative by the cell's own rho. Then the weights.
    """
    turned = rotation @ cells.rays
    y = turned + rho * translation
    front = y[:, 2:]
    z = front.clamp_min(FRONT)
    seen = y[:, :2] / z
    missed = seen - cells.matched
    squared = missed.square().sum(dim=-2, keepdim=True) / outlier**2
    # Geman-McClure: the weight of a gross outlier falls with the fourth power of its error.
    weight = torch.where(front > FRONT, cells.weight, 0.0) / ((1 + squared) * z).square()
    weights = torch.cat((weight, weight, cells.stiffness), dim=-2)
    by_pose = BY_POSE.to(y) @ torch.cat((turned, rho), dim=-2)[:, None]
    one = torch.ones_like(rho)
    # Times one, the prior's equation is left with none of the pose.
    by_pose = by_pose - torch.cat((seen, one), dim=-2)[..., None, :] * by_pose[:, 2:]
    residual = torch.cat((missed * z, rho - cells.prior), dim=-2)
    by_rho = torch.cat((translation[:, :2] - seen * translation[:, 2:], one), dim=-2)
    columns = [by_pose, residual[..., None, :], by_rho[..., None, :]]
    if cells.by_scale is not None:
        by_scale = F.pad(cells.by_scale, (0, 0, 2, 0))
        columns.insert(1, by_scale[..., None, :])
    return torch.cat(columns, dim=-2), weights[..., None, :]


def eliminate(
    equations: Float[Tensor, "2*pairs 3 columns cells"], weight: Float[Tensor, "2*pairs 3 1 cells"]
) -> tuple[
    Float[Tensor, "2*pairs columns columns"],
    Float[Tensor, "2*pairs columns cells"],
    Float[Tensor, "2*pairs 1 cells"],
]:
    """Normal equations without the cells' own depths, the last column (Schur complement).

    Returns:
        What is left of the columns' products with each other: the parameters' matrix, and beside
        it their gradient.
        How far each column times one lowers the cell's rho.
        Each rho's own precision.
    """
    with_rho = (equations * (equations[..., -1:, :] * weight)).sum(dim=1)
    precision = with_rho[..., -1:, :]
    share = with_rho / precision
    products = ((equations * weight) @ equations.transpose(-1, -2)).sum(dim=1)
    return products - share @ with_rho.transpose(-1, -2), share, precision
