"""Two-view bundle adjustment on matches, in tensor operations that every runtime has."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from styl3r_export.model.loops import Carry, repeat
from styl3r_export.model.rotations import Motion, multiply_quaternions, rotation_matrix

# Relative Levenberg damping.
DAMPING = 1e-3
# Standard deviation of a good match, in ray units (1 is the focal length): a pixel of a 256 px
# picture. It weighs matches against the priors; how large an error makes an outlier is apart.
NOISE = 0.005
# How far (radians, scene units) the first guess of a motion is trusted to be off: what decides
# where matches say nothing.
GUESS_ERROR = 1.0
# Largest step of one iteration: radians, and units of the scene.
MAX_TURN, MAX_STEP = 0.25, 0.3
# Bounds of inverse depth (the scene's unit is its median depth).
NEAREST, FARTHEST = 12.0, 0.01
# A projected point must stay in front of the camera by this (homogeneous) depth.
FRONT = 0.1
# Errors below this length (ray units) are not told apart: keeps a square root's slope finite at
# zero. Its square as a summand would be too small: graph optimisers take 1e-8 for nothing.
SHORT = 1e-4


class Sides(NamedTuple):
    """Cells of both views of every pair: the first views of all pairs, then the others.

    Each side is seen by the other through a motion of its own, the second half's being the
    inverse of the first half's, so both are projected by one and the same code.
    """

    rays: Float[Tensor, "2*pairs cells 3"]  # (x/z, y/z, 1)
    matched: Float[Tensor, "2*pairs cells 2"]  # ray of the match in the other view
    weight: Float[Tensor, "2*pairs cells"]  # confidence of the match
    prior: Float[Tensor, "2*pairs cells"]  # inverse depth
    stiffness: Float[Tensor, "2*pairs cells"]  # weight of the prior


class Fit(NamedTuple):
    """How well cells fit the adjusted motion, and how much that says of their depth."""

    error: Float[Tensor, "2*pairs cells"]  # distance to the match, ray units
    information: Float[Tensor, "2*pairs cells"]  # of inverse depth, in the match's weight


class Normal(NamedTuple):
    """Normal equations of each side in its own motion, cell depths still in."""

    pose: Float[Tensor, "2*pairs 6 6"]
    pose_gradient: Float[Tensor, "2*pairs 6"]
    cross: Float[Tensor, "2*pairs cells 6"]
    depth: Float[Tensor, "2*pairs cells"]
    depth_gradient: Float[Tensor, "2*pairs cells"]


def adjust(
    guess: Motion, sides: Sides, outliers: Sequence[float]
) -> tuple[Motion, Float[Tensor, "2*pairs cells"]]:
    """Motions and inverse depths that explain the matches of each pair in both directions.

    Damped Gauss-Newton on the six pose parameters and one inverse depth a cell, the depths
    eliminated by the Schur complement (their block is diagonal), with weights that discount
    outliers. Where matches are few the priors and the guess decide.

    Args:
        guess: where each pair's motion starts, and what it is weakly held to.
        sides: the cells and their matches.
        outliers: for each iteration the error (ray units; 1 is the focal length) at which a
            match loses three quarters of its weight: large first, since from a wrong guess
            every true match looks like an outlier (graduated non-convexity).

    Returns:
        The motions, and the inverse depths of both sides' cells.
    """

    def iteration(carry: Carry, outlier: float | Tensor) -> Carry:
        rotation, translation, rho, moved = carry
        motion = Motion(rotation, translation)
        both = both_ways(motion)
        normal = normal_equations(both, sides, rho, outlier)
        twist = twists(both)
        step = solve(*reduce(normal, twist, moved))
        step = torch.cat((limit(step[:, :3], MAX_TURN), limit(step[:, 3:], MAX_STEP)), dim=-1)
        own_step = (twist @ torch.cat((step, step))[..., None]).squeeze(-1)
        change = normal.depth_gradient + (normal.cross * own_step[:, None]).sum(dim=-1)
        rho = (rho - change / normal.depth).clamp(FARTHEST, NEAREST)
        return *move(motion, step), rho, moved + step

    still = torch.cat((guess.translation, guess.translation), dim=-1) * 0
    rotation, translation, rho, _ = repeat(iteration, (*guess, sides.prior, still), outliers)
    return Motion(rotation, translation), rho


class BothWays(NamedTuple):
    """Rotation matrices and translations from each side to the other."""

    rotation: Float[Tensor, "2*pairs 3 3"]
    translation: Float[Tensor, "2*pairs 3"]


def both_ways(motion: Motion) -> BothWays:
    """The motions, and behind them their inverses."""
    rotation = rotation_matrix(motion.rotation)
    back = rotation.transpose(-1, -2)
    translation = motion.translation
    inverse = -(back @ translation[..., None]).squeeze(-1)
    return BothWays(torch.cat((rotation, back)), torch.cat((translation, inverse)))


def twists(both: BothWays) -> Float[Tensor, "2*pairs 6 6"]:
    """How a step (turn, shift) of a pair's motion moves each side's own motion.

    The identity for the first half. For the inverse motion R', t' = R^T, -R^T t a turn w and a
    shift d of the original come out as -R' w and [t']x R' w - R' d.
    """
    pairs = both.rotation.shape[0] // 2
    rotation, shift = both.rotation[pairs:], both.translation[pairs:]
    top = torch.cat((-rotation, rotation * 0), dim=-1)
    bottom = torch.cat((skew(shift) @ rotation, -rotation), dim=-1)
    inverse = torch.cat((top, bottom), dim=-2)
    return torch.cat((torch.eye(6, device=shift.device) + inverse * 0, inverse))


def move(motion: Motion, step: Float[Tensor, "pairs 6"]) -> Motion:
    """A motion turned by a small rotation vector and shifted."""
    half = torch.cat((torch.ones_like(step[:, :1]), step[:, :3] / 2), dim=-1)
    turned = multiply_quaternions(F.normalize(half, dim=-1), motion.rotation)
    return Motion(F.normalize(turned, dim=-1), motion.translation + step[:, 3:])


def project(
    both: BothWays, sides: Sides, rho: Tensor
) -> tuple[Float[Tensor, "2*pairs cells 3"], Float[Tensor, "2*pairs cells 3"]]:
    """Cells in the other view, before and after the shift, as homogeneous points.

    With inverse depth rho the point is R r + rho t, linear in rho and defined at infinity.
    """
    turned = sides.rays @ both.rotation.transpose(-1, -2)
    return turned, turned + rho[..., None] * both.translation[:, None]


def fit(motion: Motion, sides: Sides, rho: Tensor) -> Fit:
    """Errors and depth information of all cells."""
    both = both_ways(motion)
    _, y = project(both, sides, rho)
    z = y[..., 2:].clamp_min(FRONT)
    seen, shift = y[..., :2] / z, both.translation[:, None]
    by_depth = (shift[..., :2] - seen * shift[..., 2:]) / z
    error = SHORT * (((seen - sides.matched) / SHORT).square().sum(dim=-1) + 1).sqrt()
    return Fit(error, sides.weight * by_depth.square().sum(dim=-1))


def skew(v: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Cross-product matrices."""
    x, y, z = v.unbind(-1)
    o = torch.zeros_like(x)
    return torch.stack((o, -z, y, z, o, -x, -y, x, o), dim=-1).unflatten(-1, (3, 3))


def cross(a: Float[Tensor, "*batch 3"], b: Float[Tensor, "*batch 3"]) -> Tensor:
    """Cross products a x b."""
    (ax, ay, az), (bx, by, bz) = a.unbind(-1), b.unbind(-1)
    return torch.stack((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx), dim=-1)


def normal_equations(both: BothWays, sides: Sides, rho: Tensor, outlier: float | Tensor) -> Normal:
    """Weighted squares of reprojection errors and of departures from the depth prior."""
    turned, y = project(both, sides, rho)
    z = y[..., 2:].clamp_min(FRONT)
    seen, shift = y[..., :2] / z, both.translation[:, None]
    residual = seen - sides.matched
    # d(y)/d(turn) = -[R r]x, d(y)/d(shift) = rho I; then through the division by depth.
    to_picture = torch.cat(
        (torch.eye(2, device=z.device) + seen[..., None] * 0, -seen[..., None]), -1
    )
    to_picture = to_picture / z[..., None]
    # A row r times [v]x is r x v: thousands of products of tiny matrices are slower.
    by_turn = cross(turned[..., None, :], to_picture)
    by_pose = torch.cat((by_turn, to_picture * rho[..., None, None]), dim=-1)
    by_depth = (shift[..., :2] - seen * shift[..., 2:]) / z
    squared = residual.square().sum(dim=-1) / outlier**2
    # Geman-McClure: the weight of a gross outlier falls with the fourth power of its error.
    robust = 1 / (1 + squared).square()
    weight = sides.weight * robust * (y[..., 2] > FRONT).to(y.dtype) / NOISE**2
    weighted = (by_pose * weight[..., None, None]).flatten(1, 2).transpose(-1, -2)
    depth_weighted = by_depth * weight[..., None]
    return Normal(
        pose=weighted @ by_pose.flatten(1, 2),
        pose_gradient=(weighted @ residual.flatten(1, 2)[..., None]).squeeze(-1),
        cross=(by_pose * depth_weighted[..., None]).sum(dim=2),
        depth=(depth_weighted * by_depth).sum(dim=-1) + sides.stiffness,
        depth_gradient=(depth_weighted * residual).sum(dim=-1)
        + sides.stiffness * (rho - sides.prior),
    )


def reduce(normal: Normal, twist: Tensor, moved: Float[Tensor, "pairs 6"]) -> tuple[Tensor, Tensor]:
    """Each pair's six-by-six system, the depths of both its sides eliminated."""
    share = normal.cross / normal.depth[..., None]
    matrix = normal.pose - share.transpose(-1, -2) @ normal.cross
    gradient = normal.pose_gradient - (share * normal.depth_gradient[..., None]).sum(dim=1)
    matrix = twist.transpose(-1, -2) @ matrix @ twist
    gradient = (twist.transpose(-1, -2) @ gradient[..., None]).squeeze(-1)
    pairs = moved.shape[0]
    matrix, gradient = matrix[:pairs] + matrix[pairs:], gradient[:pairs] + gradient[pairs:]
    held = GUESS_ERROR**-2
    eye = torch.eye(6, device=matrix.device)
    # What rounding leaves below zero on the diagonal must not undo the damping.
    damping = DAMPING * (matrix * eye).clamp_min(0) + held * eye
    return matrix + damping, gradient + held * moved


def solve(
    matrix: Float[Tensor, "pairs n n"], gradient: Float[Tensor, "pairs n"]
) -> Float[Tensor, "pairs n"]:
    """-matrix^-1 gradient by Gauss-Jordan elimination (symmetric, positive, damped: no pivots)."""
    m = torch.cat((matrix, -gradient[..., None]), dim=-1)
    for k, keep in enumerate(1 - torch.eye(matrix.shape[-1], device=matrix.device)):
        row = m[:, k : k + 1] / m[:, k : k + 1, k : k + 1]
        # The pivot's own row keeps nothing of itself but the normalised row.
        m = m * keep[:, None] + (1 - keep[:, None] - keep[:, None] * m[:, :, k : k + 1]) * row
    return m[..., -1]


def limit(v: Float[Tensor, "pairs 3"], most: float) -> Float[Tensor, "pairs 3"]:
    """Vectors shortened smoothly so that none is longer than `most`."""
    return v / (1 + v.square().sum(dim=-1, keepdim=True) / most**2).sqrt()
