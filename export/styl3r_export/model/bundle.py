"""Two-view bundle adjustment on matches, in tensor operations that every runtime has."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from styl3r_export.model.loops import Carry, repeat
from styl3r_export.model.normal_equations import FRONT, Cells, eliminate, linearise
from styl3r_export.model.rotations import Motion, rotation_matrix, skew, turn

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


class Solution(NamedTuple):
    """What explains the matches of each pair in both directions."""

    motion: Motion
    rho: Float[Tensor, "2*pairs cells"]  # inverse depth
    precision: Float[Tensor, "2*pairs cells"]  # of inverse depth: matches and prior


def adjust(
    guess: Motion, sides: Sides, outliers: Sequence[float]
) -> tuple[Motion, Float[Tensor, "2*pairs cells"]]:
    """Motions and inverse depths, the scale of the priors taken as it is: see `optimise`."""
    found = optimise(guess, sides, outliers, scaled=False)
    return found.motion, found.rho


def optimise(guess: Motion, sides: Sides, outliers: Sequence[float], *, scaled: bool) -> Solution:
    """Motions and inverse depths that explain the matches of each pair in both directions.

    Damped Gauss-Newton on a pair's six pose parameters and one inverse depth a cell, the depths
    eliminated by the Schur complement (their block is diagonal), with weights that discount
    outliers. Where matches are few the priors and the guess decide.

    Args:
        guess: where each pair's motion starts, and what it is weakly held to.
        sides: the cells and their matches.
        outliers: for each iteration the error (ray units; 1 is the focal length) at which a
            match loses three quarters of its weight: large first, since from a wrong guess
            every true match looks like an outlier (graduated non-convexity).
        scaled: also solve for a seventh parameter, the log scale of the second half's prior
            depths; together with the pose, since in turns they would hold each other back.
    """
    cells = cells_of(sides)
    parameters = 7 if scaled else 6
    # A step's length is bounded in each of these groups.
    groups = ((MAX_TURN, 3), (MAX_STEP, 3), (MAX_STEP, parameters - 6))
    squares = torch.block_diag(*(torch.full((n, n), most**-2) for most, n in groups if n))
    squares = squares.to(cells.rays.device)

    def iteration(carry: Carry, outlier: float | Tensor) -> Carry:
        rotation, translation, rho, moved, _ = carry
        pairs, rho = translation.shape[0], rho[:, None]
        both = both_ways(Motion(rotation, translation))
        held = rescale(cells, moved[:, 6:]) if scaled else cells
        equations, weight = linearise(
            both.rotation, both.translation[..., None], held, rho, outlier
        )
        system, share, precision = eliminate(equations, weight)
        twist = twists(both.rotation[pairs:], translation, system.shape[-1])
        matrix = system[:pairs] + twist.transpose(-1, -2) @ system[pairs:] @ twist
        step = solve(*damped(matrix, moved))
        step = step / (1 + step.square() @ squares).sqrt()
        # Against the equations' columns: the step, the residual as it is, nothing of the depth.
        first = F.pad(F.pad(step, (0, 1), value=1.0), (0, 1))[:, None]
        rho = rho - torch.cat((first, first @ twist.transpose(-1, -2))) @ share
        rho, precision = rho.clamp(FARTHEST, NEAREST).squeeze(1), precision.squeeze(1)
        turned, moved_to = turn(rotation, step[:, :3]), translation + step[:, 3:6]
        return turned, moved_to, rho, moved + step, precision

    still = F.pad(guess.translation * 0, (0, parameters - 3))
    start = (*guess, sides.prior, still, sides.prior * 0)
    rotation, translation, rho, _, precision = repeat(iteration, start, outliers)
    return Solution(Motion(rotation, translation), rho, precision)


def cells_of(sides: Sides) -> Cells:
    """Both sides as the solver reads them."""
    return Cells(
        rays=sides.rays.transpose(-1, -2).contiguous(),
        matched=sides.matched.transpose(-1, -2).contiguous(),
        weight=sides.weight[:, None] / NOISE**2,
        prior=sides.prior[:, None],
        stiffness=sides.stiffness[:, None],
        by_scale=None,
    )


def rescale(cells: Cells, log_scale: Float[Tensor, "pairs 1"]) -> Cells:
    """Prior depths of the second half, scaled; relative errors stay what they were."""
    shrink = torch.cat((log_scale * 0, -log_scale)).exp()[..., None]
    prior, stiffness = cells.prior * shrink, cells.stiffness / shrink.square()
    of_scale = torch.cat((log_scale * 0, log_scale * 0 + 1))[..., None]
    return cells._replace(prior=prior, stiffness=stiffness, by_scale=prior * of_scale)


def twists(
    back: Float[Tensor, "pairs 3 3"], translation: Float[Tensor, "pairs 3"], columns: int
) -> Float[Tensor, "pairs columns columns"]:
    """How a step (turn, shift) of a pair's motion moves the inverse motion; the rest stays.

    For the inverse motion R^T, -R^T t a turn w and a shift d of the original come out as -R^T w
    and -R^T [t]x w - R^T d.
    """
    shift = torch.cat((back @ skew(translation), back), dim=-1)
    pose = torch.cat((F.pad(back, (0, 3)), shift), dim=-2)
    rest = F.pad(torch.eye(columns - 6, device=back.device), (6, 0, 6, 0))
    return rest - F.pad(pose, (0, columns - 6, 0, columns - 6))


def damped(
    system: Float[Tensor, "pairs columns columns"], moved: Float[Tensor, "pairs parameters"]
) -> tuple[Float[Tensor, "pairs parameters parameters"], Float[Tensor, "pairs parameters"]]:
    """Matrix and gradient of a pair's parameters, damped and held to the guess."""
    n = moved.shape[-1]
    matrix, gradient = system[:, :n, :n], system[:, :n, n]
    held = GUESS_ERROR**-2
    # What rounding leaves below zero on the diagonal must not undo the damping.
    damping = (DAMPING * matrix.clamp_min(0) + held) * torch.eye(n, device=matrix.device)
    return matrix + damping, gradient + held * moved


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


def fit(motion: Motion, sides: Sides, rho: Tensor) -> Fit:
    """Errors and depth information of all cells."""
    both = both_ways(motion)
    shift = both.translation[:, None]
    y = sides.rays @ both.rotation.transpose(-1, -2) + rho[..., None] * shift
    z = y[..., 2:].clamp_min(FRONT)
    seen = y[..., :2] / z
    by_depth = (shift[..., :2] - seen * shift[..., 2:]) / z
    error = SHORT * (((seen - sides.matched) / SHORT).square().sum(dim=-1) + 1).sqrt()
    return Fit(error, sides.weight * by_depth.square().sum(dim=-1))


def solve(
    matrix: Float[Tensor, "pairs n n"], gradient: Float[Tensor, "pairs n"]
) -> Float[Tensor, "pairs n"]:
    """-matrix^-1 gradient by Gauss-Jordan elimination (symmetric, positive, damped: no pivots)."""
    m = torch.cat((matrix, -gradient[..., None]), dim=-1)
    for k, unit in enumerate(torch.eye(matrix.shape[-1], device=matrix.device)[..., None]):
        row = m[:, k : k + 1]
        # The pivot's own row keeps nothing of itself but the normalised row.
        others = m * (1 - unit)
        m = others + (unit - others[:, :, k : k + 1]) * (row / row[:, :, k : k + 1])
    return m[..., -1]
