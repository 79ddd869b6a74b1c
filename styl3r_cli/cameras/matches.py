"""Which places of a scene's photos show the same, by SIFT's features."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.two_view import Features, features, match
from styl3r_cli.threads import in_threads


class Matches(NamedTuple):
    """Two views' features that match.

    Attributes:
        first: index of a view.
        second: of a later one.
        pixels: (M, 2) each, where both show them; the first pixel's centre is at (0.5, 0.5).
    """

    first: int
    second: int
    pixels: tuple[NDArray[np.float64], NDArray[np.float64]]


def match_views(
    pictures: Sequence[NDArray[np.uint8]], size: tuple[int, int], threads: int | None = None
) -> list[Matches]:
    """Every two views' matches. Same pictures, same matches, at any number of threads.

    Args:
        pictures: N times (h, w, 3) RGB, of any size each.
        size: (height, width) of the views, in whose pixels the matches are told.
        threads: None for every core.
    """

    def find(picture: NDArray[np.uint8]) -> Features:
        found = features(picture)
        shrunk = np.array(size[::-1]) / np.array(picture.shape[1::-1])
        return found._replace(pixels=found.pixels * shrunk)

    found = in_threads(find, list(pictures), threads)

    def look(pair: tuple[int, int]) -> Matches:
        first, second = pair
        return Matches(first, second, match(found[first], found[second]))

    return in_threads(look, list(combinations(range(len(pictures)), 2)), threads)


def as_pictures(images: NDArray[np.float32]) -> list[NDArray[np.uint8]]:
    """N times (H, W, 3) of views (N, 3, H, W) in [0, 1]."""
    return list((images.transpose(0, 2, 3, 1) * 255).round().clip(0, 255).astype(np.uint8))
