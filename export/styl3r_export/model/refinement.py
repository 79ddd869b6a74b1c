"""Decoded depths made to agree with the matches: a scale for each view, then single cells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from styl3r_export.model.bundle import FARTHEST, NEAREST, Sides, fit, optimise
from styl3r_export.model.matching import cell_centres
from styl3r_export.model.rotations import Motion, full_precision

# Pixels a side of one cell.
CELL = 8
# True depth errors over predicted ones. A cell's error is shared with its neighbours, so it
# counts more often than once, and photos are harder than generated scenes.
MODESTY = 2.0
# Errors (ray units; a cell of a 256 px picture is about 0.03 wide) at which matches are
# discounted, by iteration.
OUTLIERS = (0.12, 0.08, 0.05, 0.03, 0.02, 0.015, 0.01)
# Largest correction of log depth, a factor of two: beyond it a match is more likely wrong than
# the decoder is.
MAX_CORRECTION = 0.7


# A match counts for or against a view's camera from this weight on (expected error three hundredths
# of the focal length), and agrees with it up to this error.
FAIR_WEIGHT, FAIR_ERROR = 0.027, 0.02
# Share of its cells that must agree for a view to be trusted not at all, and wholly. On real pairs
# with a share under 0.1 most cameras were wrong, over 0.2 hardly any.
LOST, FOUND = 0.04, 0.14


class Refined(NamedTuple):
    """Cameras and depths that agree with each other."""

    motion: Motion  # (batch * others) pairs
    depth: Float[Tensor, "batch views H W"]
    trust: Float[Tensor, "batch views"]  # in [0, 1]: whether the view's camera was found


def refine(
    guess: Motion,
    depth: Float[Tensor, "batch views H W"],
    log_error: Float[Tensor, "batch views H W"],
    matches: Sides,
) -> Refined:
    """Pull cameras, scales and depths to where the views' points meet along their matches.

    Each view but the first gets a pose and one scale for all of its depths, every 1/8 cell a
    depth of its own; all are weakly held to what was decoded, depths as firmly as their expected
    errors say. Without matches nothing moves.

    Args:
        guess: world-to-camera motions, (batch * others) pairs.
        depth: along each view's z axis; H and W multiples of 16.
        log_error: log of the depth's expected relative error.
        matches: both sides of every pair, their depths not yet decoded.

    Returns:
        The motions, the depths times a smooth correction (at most a factor of two), and how far
        each view is to be trusted.
    """
    batch, views = depth.shape[:2]
    rows, columns = depth.shape[-2] // CELL, depth.shape[-1] // CELL
    with full_precision(depth):
        sides = known_sides(matches, depth, log_error)
        adjusted = adjust_scaled(guess, sides, OUTLIERS)
        here = fuse(adjusted, sides, (batch, views - 1))
        there = adjusted.change[batch * (views - 1) :].unflatten(0, (batch, views - 1))
        change = torch.cat((here[:, None], there), dim=1)
        change = change.clamp(-MAX_CORRECTION, MAX_CORRECTION)
        change = change.unflatten(-1, (rows, columns))
        change = F.interpolate(change, scale_factor=CELL, mode="bilinear")
        trust = agreement(adjusted, sides).unflatten(0, (batch, views - 1))
        trust = F.pad(((trust - LOST) / (FOUND - LOST)).clamp(0, 1), (1, 0), value=1.0)
    return Refined(adjusted.motion, depth * change.exp(), trust)


def agreement(adjusted: Adjusted, sides: Sides) -> Float[Tensor, " pairs"]:
    """Share of both sides' cells whose match is fairly sure and where the camera says it is."""
    rho = sides.prior * (-adjusted.change).exp()
    error = fit(adjusted.motion, sides, rho).error
    fair = sides.weight / (sides.weight + FAIR_WEIGHT)
    share = (fair / (1 + (error / FAIR_ERROR).square()).square()).mean(dim=-1)
    pairs = adjusted.motion.translation.shape[0]
    return (share[:pairs] + share[pairs:]) / 2


def known_sides(sides: Sides, depth: Tensor, log_error: Tensor) -> Sides:
    """The matches' two sides of every pair, with decoded depths as priors."""
    others = depth.shape[1] - 1
    z, error = cell_centres(depth), cell_centres(log_error)
    rho = (1 / z).clamp(FARTHEST, NEAREST)
    stiffness = (error.exp() * MODESTY * rho).square().reciprocal()

    def both(t: Tensor) -> Tensor:
        first = t[:, :1].expand(-1, others, -1)
        return torch.cat((first.flatten(0, 1), t[:, 1:].flatten(0, 1)))

    return sides._replace(prior=both(rho), stiffness=both(stiffness))


class Adjusted(NamedTuple):
    """Cameras, and what has become of both sides' cells."""

    motion: Motion
    change: Float[Tensor, "2*pairs cells"]  # of log depth, scale and all
    precision: Float[Tensor, "2*pairs cells"]  # of inverse depth: matches and prior


def adjust_scaled(guess: Motion, sides: Sides, outliers: Sequence[float]) -> Adjusted:
    """`bundle.optimise` with a seventh parameter, the scale of the other view's decoded depths.

    Errors of one view's depths are mostly common to all of them; a scale of its own lets the
    view follow the matches where single depths, each held to its prior, would not.
    """
    found = optimise(guess, sides, outliers, scaled=True)
    return Adjusted(found.motion, (sides.prior / found.rho).log(), found.precision)


def fuse(adjusted: Adjusted, sides: Sides, pairs: tuple[int, int]) -> Float[Tensor, "batch cells"]:
    """Change of the first view's log depth that all other views together ask for.

    Every pair has held the cell to the same prior, which must count once.

    Args:
        adjusted: of all pairs.
        sides: as they were decoded.
        pairs: number of scenes, and of other views in each.
    """
    all_sides = (adjusted.change, adjusted.precision, sides.stiffness)
    first = (t[: pairs[0] * pairs[1]].unflatten(0, pairs) for t in all_sides)
    change, precision, stiffness = first
    matched = (precision - stiffness).sum(dim=1)
    return (change * precision).sum(dim=1) / (matched + stiffness[:, 0])
