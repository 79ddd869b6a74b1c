"""Semi-global matching against the recurrence as it is written down, pixel by pixel."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from styl3r_cli.stereo.semiglobal import EDGE, JUMP, LEAST_JUMP, SLANT, best_labels

Array = NDArray[np.float64]


def slowly(costs: Array, picture: Array) -> Array:
    """Hirschmueller 2008, equation 13, along four directions, in float64: (L, H, W) sums."""
    labels, height, width = costs.shape
    total = np.zeros_like(costs)
    for down, right in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        paths = np.zeros_like(costs)
        rows = range(height) if down >= 0 else range(height - 1, -1, -1)
        columns = range(width) if right >= 0 else range(width - 1, -1, -1)
        for y in rows:
            for x in columns:
                paths[:, y, x] = costs[:, y, x]
                back, left = y - down, x - right
                if not (0 <= back < height and 0 <= left < width):
                    continue
                before = paths[:, back, left]
                change = np.abs(picture[y, x] - picture[back, left]).max()
                jump = max(LEAST_JUMP, JUMP * math.exp(-change / EDGE))
                for label in range(labels):
                    ways = [before[label], before.min() + jump]
                    ways += [before[n] + SLANT for n in (label - 1, label + 1) if 0 <= n < labels]
                    paths[label, y, x] += min(ways) - before.min()
        total += paths
    return total


@settings(max_examples=25, deadline=None)
@given(st.integers(3, 6), st.integers(1, 6), st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_labels_are_those_of_the_recurrence(
    labels: int, height: int, width: int, seed: int
) -> None:
    random = np.random.default_rng(seed)
    costs = random.uniform(0, 1, (labels, height, width))
    picture = random.uniform(0, 0.4, (height, width, 3))
    found = best_labels(costs.astype(np.float32), picture.astype(np.float32))
    total = slowly(costs, picture)
    # Within half a label of the best; where two are as good, either.
    whole = np.rint(found).clip(0, labels - 1).astype(int)
    chosen = np.take_along_axis(total, whole[None], 0)[0]
    either = np.take_along_axis(total, (2 * found - whole).round().astype(int)[None], 0)[0]
    np.testing.assert_allclose(np.minimum(chosen, either), total.min(axis=0), atol=1e-5)


@given(st.floats(1.0, 5.0))
def test_labels_lie_between_where_costs_say_so(true: float) -> None:
    costs = 0.001 * (np.arange(7) - true) ** 2
    found = best_labels(
        np.tile(costs[:, None, None], (1, 2, 2)).astype(np.float32), np.zeros((2, 2, 3), np.float32)
    )
    np.testing.assert_allclose(found, true, atol=0.02)


def test_noise_gives_way_to_neighbours_and_edges_stay() -> None:
    random = np.random.default_rng(0)
    true = np.where(np.arange(40) < 20, 2, 7)[None].repeat(40, axis=0)
    picture = (true[..., None] / 10 * np.ones(3)).astype(np.float32)
    costs = 0.3 * np.minimum(np.abs(np.arange(10)[:, None, None] - true), 2)
    costs = (costs + random.uniform(0, 1.0, costs.shape)).astype(np.float32)
    alone = costs.argmin(axis=0)
    assert (np.abs(alone - true) > 1).mean() > 0.08
    found = best_labels(costs, picture)
    assert (np.abs(found - true) > 1).mean() < 0.01


def test_a_slant_costs_less_than_a_jump() -> None:
    assert SLANT < LEAST_JUMP < JUMP == pytest.approx(0.8)
