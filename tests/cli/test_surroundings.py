"""Holes are filled with what is around them; what is covered stays as it was."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from styl3r_cli.surroundings import fill_holes

SHAPES = st.tuples(st.integers(1, 40), st.integers(1, 40))


@st.composite
def frames(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Straight colours and alpha."""
    height, width = draw(SHAPES)
    unit = st.floats(0, 1, width=32)
    colour = draw(arrays.arrays(np.float32, (height, width, 3), elements=unit))
    return colour, draw(arrays.arrays(np.float32, (height, width), elements=unit))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(frames())
def test_filled_frames_stay_within_the_colours_that_are_seen(
    frame: tuple[np.ndarray, np.ndarray],
) -> None:
    colour, alpha = frame
    filled = fill_holes(colour * alpha[..., None], alpha)
    assert filled.shape == colour.shape
    assert filled.dtype == np.float32
    seen = colour[alpha > 1e-3]
    if len(seen) and alpha.mean() > 1e-3:
        assert filled.min() >= colour.min() - 1e-4
        assert filled.max() <= colour.max() + 1e-3


@settings(max_examples=40, deadline=None, derandomize=True)
@given(frames(), st.tuples(*[st.floats(0, 1, width=32)] * 3))
def test_what_is_covered_stays_and_one_colour_fills_with_itself(
    frame: tuple[np.ndarray, np.ndarray], one: tuple[float, float, float]
) -> None:
    colour, alpha = frame
    solid = np.where(alpha > 0.5, np.float32(1), np.float32(0))
    filled = fill_holes(colour * solid[..., None], solid)
    np.testing.assert_array_equal(filled[solid == 1], colour[solid == 1])
    if solid.any():
        flat = np.broadcast_to(np.float32(one), colour.shape)
        np.testing.assert_allclose(fill_holes(flat * solid[..., None], solid), flat, atol=1e-4)


def test_a_hole_gets_its_rims_colours_side_by_side() -> None:
    colour = np.zeros((64, 64, 3), np.float32)
    colour[:, :24], colour[:, 40:] = (1, 0, 0), (0, 0, 1)
    alpha = np.zeros((64, 64), np.float32)
    alpha[:, :24] = alpha[:, 40:] = 1
    middle = fill_holes(colour, alpha)[32, 24:40]
    assert middle[0, 0] > 0.7 > 0.3 > middle[-1, 0]
    assert (np.diff(middle[:, 0]) <= 1e-6).all()
    np.testing.assert_allclose(middle.sum(axis=1), 1, atol=1e-5)  # no darkness in between


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (33, 2)])
def test_an_empty_frame_is_black(shape: tuple[int, int]) -> None:
    np.testing.assert_array_equal(fill_holes(np.zeros((*shape, 3)), np.zeros(shape)), 0)
