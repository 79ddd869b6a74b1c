"""Rounding: three parts of a rotation, the order along a curve, and codebooks."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from styl3r_cli.formats.codebook import SIZE, make_codebook
from styl3r_cli.formats.quantise import (
    HALF,
    MORTON_BITS,
    from_smallest_three,
    morton_order,
    smallest_three,
    to_levels,
)

parts = st.floats(-1, 1)


@given(hnp.arrays(np.float64, (5, 4), elements=parts))
@settings(max_examples=100, deadline=None)
def test_three_parts_of_a_rotation_are_enough(quaternions: np.ndarray) -> None:
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    quaternions = np.where(lengths > 1e-3, quaternions / lengths.clip(1e-3), [1.0, 0, 0, 0])
    largest, others = smallest_three(quaternions)
    assert (np.abs(others) <= HALF + 1e-12).all()
    back = from_smallest_three(largest, others)
    signs = np.sign((back * quaternions).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(back * signs, quaternions, atol=1e-7)


def test_levels_are_the_nearest() -> None:
    assert to_levels(np.array([-1, 0, 0.49, 0.51, 1, 7]), 1).tolist() == [0, 0, 0, 1, 1, 1]


def interleaved(levels: list[int]) -> int:
    """Bit by bit, as the curve is defined."""
    code = 0
    for bit in range(MORTON_BITS):
        for axis, level in enumerate(levels):
            code |= (level >> bit & 1) << (3 * bit + axis)
    return code


def test_the_order_is_that_of_interleaved_bits() -> None:
    rng = np.random.default_rng(0)
    top = (1 << MORTON_BITS) - 1
    levels = rng.integers(0, top + 1, (200, 3))
    levels[0], levels[1] = 0, top  # the corners of the box
    order = morton_order((levels / 1024).astype(np.float32))
    exact = np.round(levels / 1024 * 1024).astype(int)
    codes = [interleaved(row.tolist()) for row in exact]
    found = [codes[index] for index in order]
    # float32 has 24 bits, which is enough for 21; the cells' lower ends may round down by one
    assert sum(a > b for a, b in pairwise(found)) <= 2
    assert sorted(order.tolist()) == list(range(200))


def test_equal_points_keep_their_order() -> None:
    assert morton_order(np.ones((50, 3), np.float32)).tolist() == list(range(50))
    assert morton_order(np.zeros((0, 3), np.float32)).tolist() == []


@given(hnp.arrays(np.float32, st.integers(0, SIZE), elements=st.floats(-100, 100, width=32)))
@settings(max_examples=60, deadline=None)
def test_few_different_numbers_are_kept_exactly(values: np.ndarray) -> None:
    book, indices = make_codebook(np.concatenate([values, values[::-1]]))
    assert len(book) == SIZE
    np.testing.assert_array_equal(book[indices], np.concatenate([values, values[::-1]]))


@pytest.mark.parametrize("kind", ["uniform", "normal"])
def test_many_numbers_are_near_the_codebooks(kind: str) -> None:
    rng = np.random.default_rng(0)
    values = rng.uniform(0, 1, 20_000) if kind == "uniform" else rng.normal(size=20_000)
    book, indices = make_codebook(values)
    assert (np.diff(book) >= 0).all()
    errors = np.abs(book[indices] - values)
    nearest = np.abs(book[None] - values[::40, None]).min(axis=1)
    np.testing.assert_allclose(errors[::40], nearest, atol=1e-7)
    even = (values.max() - values.min()) / SIZE
    assert errors.max() < 2.5 * even
    assert np.sqrt(np.square(errors).mean()) < 1.05 * even / np.sqrt(12)
