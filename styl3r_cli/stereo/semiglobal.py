"""Semi-global matching (Hirschmueller 2008): the labels that neighbours agree on.

Every pixel has a cost for each label. Along each line of the picture dynamic programming adds what
it costs to reach a label from the neighbour's; the sums over four directions decide.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.gaussians import FloatArray

# What a step to the next label costs (a slanted surface), in costs of 0 to 1.
SLANT = 0.05
# What any other step costs (an edge) where colours stay the same, and by which difference of
# colour, 0 to 1, this falls to its e-th part; it costs no less than a slant, half as much again.
# A third to twice as much makes little difference: real photos are off by 2 % more or less.
JUMP, EDGE, LEAST_JUMP = 0.8, 0.1, 1.5 * SLANT


def best_labels(costs: FloatArray, picture: FloatArray) -> NDArray[np.float64]:
    """(H, W) labels, between two where the costs around the least say so.

    Args:
        costs: (L, H, W), at least three labels.
        picture: (H, W, 3) in [0, 1]: where colours change, labels may.
    """
    costs = np.ascontiguousarray(costs.transpose(1, 2, 0))
    across = np.ascontiguousarray(costs.transpose(1, 0, 2))
    total = _down_and_up(costs, picture)
    total += _down_and_up(across, picture.transpose(1, 0, 2)).transpose(1, 0, 2)
    return _least(total)


def _down_and_up(costs: FloatArray, picture: FloatArray) -> FloatArray:
    """Costs (H, W, L) with what it takes to come there, from above plus from below."""
    change = np.abs(np.diff(picture, axis=0)).max(axis=-1)
    jumps = np.maximum(LEAST_JUMP, JUMP * np.exp(-change / EDGE)).astype(np.float32)[..., None]
    total = np.zeros_like(costs)
    _sweep(costs, jumps, total)
    _sweep(costs[::-1], jumps[::-1], total[::-1])
    return total


def _sweep(costs: FloatArray, jumps: FloatArray, total: FloatArray) -> None:
    """Add the costs to come to each label of each row from the row before."""
    reached = costs[0]
    total[0] += reached
    for row, jump in enumerate(jumps, 1):
        least = reached.min(axis=1, keepdims=True)
        step = reached + np.float32(SLANT)
        best = np.minimum(reached, least + jump)
        np.minimum(best[:, 1:], step[:, :-1], out=best[:, 1:])
        np.minimum(best[:, :-1], step[:, 1:], out=best[:, :-1])
        best += costs[row]
        best -= least  # which every label would carry along
        total[row] += best
        reached = best


def _least(costs: FloatArray) -> NDArray[np.float64]:
    """(H, W) where costs (H, W, L) are least: the lowest point of a parabola around it."""
    label = costs.argmin(axis=2)
    middle = label.clip(1, costs.shape[2] - 2)
    before, here, after = (
        np.take_along_axis(costs, (middle + k)[..., None], 2)[..., 0].astype(np.float64)
        for k in (-1, 0, 1)
    )
    bend = before - 2 * here + after
    with np.errstate(all="ignore"):
        between = np.where(bend > 0, (before - after) / (2 * bend), 0).clip(-0.5, 0.5)
    return np.where(label == middle, middle + between, label)
