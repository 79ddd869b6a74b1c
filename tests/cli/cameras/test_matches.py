"""Features that match, in the views' own pixels, whatever size they were sought in."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from styl3r_cli.cameras.matches import match_views

SIZE = (96, 128)  # of the views
SHIFT = np.array([12.0, 20.0])  # of the second over the first, in their pixels


def pictures(times: float, count: int = 2) -> list[NDArray[np.uint8]]:
    """Crops of one texture, each further right and down, so many times as large as the views."""
    noise = sum(
        cv2.resize(np.random.default_rng(0).random((side, side, 3)), (900, 900), interpolation=2)
        for side in (30, 60, 120)
    )
    whole = (noise / 3 * 255).astype(np.uint8)
    height, width = (int(side * times) for side in SIZE)
    made = []
    for index in range(count):
        left, top = (SHIFT * times * index).astype(int)
        made.append(whole[top : top + height, left : left + width])
    return made


@pytest.mark.parametrize("times", [1, 2, 4])
def test_pixels_are_the_views(times: int) -> None:
    (found,) = match_views(pictures(times), SIZE)
    assert (found.first, found.second) == (0, 1)
    one, two = found.pixels
    assert len(one) >= 10
    off = np.linalg.norm(one - two - SHIFT, axis=1)
    assert np.median(off) < 0.1 / times
    assert (one < np.array(SIZE[::-1])).all()
    assert (one > 0).all()


def test_every_pair_and_any_number_of_threads() -> None:
    one, three = (match_views(pictures(2, 4), SIZE, threads) for threads in (1, 3))
    pairs = [(each.first, each.second) for each in one]
    assert pairs == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    for a, b in zip(one, three, strict=True):
        np.testing.assert_array_equal(a.pixels, b.pixels)


def test_views_may_be_looked_at_in_other_sizes() -> None:
    one, two = pictures(2)
    height, width, _ = two.shape
    larger = cv2.resize(two, (width * 3 // 2, height * 3 // 2), interpolation=cv2.INTER_CUBIC)
    (found,) = match_views([one, larger.clip(0, 255).astype(np.uint8)], SIZE)
    off = np.linalg.norm(found.pixels[0] - found.pixels[1] - SHIFT, axis=1)
    assert len(off) >= 10
    assert np.median(off) < 0.3


def test_where_nothing_is_nothing_matches() -> None:
    (found,) = match_views([np.zeros((96, 128, 3), np.uint8)] * 2, SIZE)
    assert found.pixels[0].shape == found.pixels[1].shape == (0, 2)
