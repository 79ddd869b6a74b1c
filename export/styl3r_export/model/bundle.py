"""Two-view bundle adjustment on matches, in tensor operations that every runtime has."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from styl3r_export.model.rotations import Motion, multiply_quaternions, rotation_matrix

# Relative Levenberg damping.
DAMPING = 1e-3
# How far (radians, scene units) the first guess of a motion is trusted to be off: what decides
# where matches say nothing.
GUESS_ERROR = 0.2
# Largest step of one iteration: radians, and units of the scene.
MAX_TURN, MAX_STEP = 0.25, 0.3
# Bounds of inverse depth (the scene's unit is its median depth).
NEAREST, FARTHEST = 12.0, 0.01
# A projected point must stay in front of the camera by this (homogeneous) depth.
FRONT = 0.1
# Keeps a square root's slope finite at zero.
TINY = 1e-8


class Side(NamedTuple):
    """Cells of one view of a pair, where they match in the other, and what is known of them."""

    rays: Float[Tensor, "pairs cells 2"]
    matched: Float[Tensor, "pairs cells 2"]  # ray of the match in the other view
    weight: Float[Tensor, "pairs cells"]  # confidence of the match
    prior: Float[Tensor, "pairs cells"]  # inverse depth
    stiffness: Float[Tensor, "pairs cells"]  # weight of the prior


class Residuals(NamedTuple):
    """How well one side's cells fit the adjusted motion, and how much that says of depth."""

    error: Float[Tensor, "pairs cells"]  # distance to the match, ray units
    information: Float[Tensor, "pairs cells"]  # of inverse depth, in the match's weight


class Normal(NamedTuple):
    """Normal equations of one side, cell depths still in."""

    pose: Float[Tensor, "pairs 6 6"]
    pose_gradient: Float[Tensor, "pairs 6"]
    cross: Float[Tensor, "pairs cells 6"]
    depth: Float[Tensor, "pairs cells"]
    depth_gradient: Float[Tensor, "pairs cells"]


def adjust(
    guess: Motion, here: Side, there: Side, outliers: Sequence[float]
) -> tuple[Motion, Tensor, Tensor]:
    """Cameras and inverse depths that explain the matches of a pair in both directions.

    Damped Gauss-Newton on the six pose parameters and one inverse depth a cell, the depths
    eliminated by the Schur complement (their block is diagonal), with weights that discount
    outliers. Where matches are few the priors and the guess decide.

    Args:
        guess: where the motion starts, and what it is weakly held to.
        here: the first view's cells.
        there: the other view's cells.
        outliers: for each iteration the error (ray units; 1 is the focal length) at which a
            match loses three quarters of its weight: large first, since from a wrong guess
            every true match looks like an outlier (graduated non-convexity).

    Returns:
        The motion, and the inverse depths of both sides' cells.
    """
    motion, rho_here, rho_there = guess, here.prior, there.prior
    moved = torch.zeros_like(torch.cat((guess.translation, guess.translation), dim=-1))
    for outlier in outliers:
        a = normal_equations(*project(motion, here.rays, rho_here), here, rho_here, outlier)
        b = normal_equations(
            *project_back(motion, there.rays, rho_there), there, rho_there, outlier
        )
        step = solve(*reduce(a, b, moved))
        step = torch.cat((limit(step[:, :3], MAX_TURN), limit(step[:, 3:], MAX_STEP)), dim=-1)
        rho_here = back_substitute(a, step, rho_here)
        rho_there = back_substitute(b, step, rho_there)
        motion, moved = move(motion, step), moved + step
    return motion, rho_here, rho_there


def move(motion: Motion, step: Float[Tensor, "pairs 6"]) -> Motion:
    """A motion turned by a small rotation vector and shifted."""
    half = torch.cat((torch.ones_like(step[:, :1]), step[:, :3] / 2), dim=-1)
    turned = multiply_quaternions(F.normalize(half, dim=-1), motion.rotation)
    return Motion(F.normalize(turned, dim=-1), motion.translation + step[:, 3:])


def residuals(motion: Motion, side: Side, rho: Tensor, *, back: bool) -> Residuals:
    """Errors and depth information of one side's cells (`back`: the other view's)."""
    y, _, by_depth = (project_back if back else project)(motion, side.rays, rho)
    z = y[..., 2:].clamp_min(FRONT)
    seen = y[..., :2] / z
    j_depth = (by_depth[..., :2] - seen * by_depth[..., 2:]) / z
    error = ((seen - side.matched).square().sum(dim=-1) + TINY).sqrt()
    return Residuals(error, side.weight * j_depth.square().sum(dim=-1))


def homogeneous(rays: Float[Tensor, "pairs cells 2"]) -> Float[Tensor, "pairs cells 3"]:
    """(x, y) to (x, y, 1)."""
    return F.pad(rays, (0, 1), value=1.0)


def project(motion: Motion, rays: Tensor, rho: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The first view's cells in the other: point / depth, and its derivatives.

    With inverse depth rho the projected point is y = R r + rho t, linear in rho and defined for
    points at infinity.
    """
    rotation, translation = rotation_matrix(motion.rotation), motion.translation
    turned = homogeneous(rays) @ rotation.transpose(-1, -2)
    y = turned + rho[..., None] * translation[:, None]
    by_move = rho[..., None, None] * torch.eye(3, device=rho.device)
    return y, torch.cat((-skew(turned), by_move), dim=-1), translation[:, None].expand_as(y)


def project_back(motion: Motion, rays: Tensor, rho: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The other view's cells in the first: y = R^T (r - rho t), and its derivatives."""
    rotation, translation = rotation_matrix(motion.rotation), motion.translation
    v = homogeneous(rays) - rho[..., None] * translation[:, None]
    y = v @ rotation
    back = rotation.transpose(-1, -2)[:, None]
    by_move = -rho[..., None, None] * back
    by_depth = -(translation[:, None] @ rotation).expand_as(y)
    return y, torch.cat((back @ skew(v), by_move), dim=-1), by_depth


def skew(v: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Cross-product matrices."""
    x, y, z = v.unbind(-1)
    o = torch.zeros_like(x)
    return torch.stack((o, -z, y, z, o, -x, -y, x, o), dim=-1).unflatten(-1, (3, 3))


def normal_equations(
    y: Float[Tensor, "pairs cells 3"],
    by_pose: Float[Tensor, "pairs cells 3 6"],
    by_depth: Float[Tensor, "pairs cells 3"],
    side: Side,
    rho: Float[Tensor, "pairs cells"],
    outlier: float,
) -> Normal:
    """Weighted squares of reprojection errors and of departures from the depth prior."""
    z = y[..., 2:].clamp_min(FRONT)
    seen = y[..., :2] / z
    residual = seen - side.matched
    j_pose = (by_pose[..., :2, :] - seen[..., None] * by_pose[..., 2:, :]) / z[..., None]
    j_depth = (by_depth[..., :2] - seen * by_depth[..., 2:]) / z
    squared = residual.square().sum(dim=-1) / outlier**2
    # Geman-McClure: the weight of a gross outlier falls with the fourth power of its error.
    robust = 1 / (1 + squared).square()
    weight = side.weight * robust * (y[..., 2] > FRONT).to(y.dtype) / outlier**2
    weighted = j_pose * weight[..., None, None]
    depth_weighted = j_depth * weight[..., None]
    return Normal(
        pose=torch.einsum("pcki,pckj->pij", weighted, j_pose),
        pose_gradient=torch.einsum("pcki,pck->pi", weighted, residual),
        cross=torch.einsum("pcki,pck->pci", weighted, j_depth),
        depth=(depth_weighted * j_depth).sum(dim=-1) + side.stiffness,
        depth_gradient=(depth_weighted * residual).sum(dim=-1)
        + side.stiffness * (rho - side.prior),
    )


def reduce(a: Normal, b: Normal, moved: Float[Tensor, "pairs 6"]) -> tuple[Tensor, Tensor]:
    """The six-by-six system that is left when the depths of both sides are eliminated."""
    matrix, gradient = a.pose + b.pose, a.pose_gradient + b.pose_gradient
    for side in (a, b):
        share = side.cross / side.depth[..., None]
        matrix = matrix - share.transpose(-1, -2) @ side.cross
        gradient = gradient - (share * side.depth_gradient[..., None]).sum(dim=1)
    held = GUESS_ERROR**-2
    damping = DAMPING * matrix.diagonal(dim1=-2, dim2=-1).clamp_min(0) + held
    return matrix + torch.diag_embed(damping), gradient + held * moved


def back_substitute(
    side: Normal, step: Float[Tensor, "pairs 6"], rho: Float[Tensor, "pairs cells"]
) -> Float[Tensor, "pairs cells"]:
    """Inverse depths after the pose has moved by `step`."""
    change = (side.depth_gradient + (side.cross * step[:, None]).sum(dim=-1)) / side.depth
    return (rho - change).clamp(FARTHEST, NEAREST)


def solve(
    matrix: Float[Tensor, "pairs n n"], gradient: Float[Tensor, "pairs n"]
) -> Float[Tensor, "pairs n"]:
    """-matrix^-1 gradient by Gauss-Jordan elimination (symmetric, positive, damped: no pivots)."""
    m = torch.cat((matrix, -gradient[..., None]), dim=-1)
    for k in range(matrix.shape[-1]):
        row = m[:, k : k + 1] / m[:, k : k + 1, k : k + 1]
        column = m[:, :, k : k + 1]
        m = m - column * row
        m = torch.cat((m[:, :k], row, m[:, k + 1 :]), dim=1)
    return m[..., -1]


def limit(v: Float[Tensor, "pairs 3"], most: float) -> Float[Tensor, "pairs 3"]:
    """Vectors shortened smoothly so that none is longer than `most`."""
    return v / (1 + v.square().sum(dim=-1, keepdim=True) / most**2).sqrt()
