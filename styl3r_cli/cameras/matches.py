"""Which places of a scene's photos show the same, by SIFT's features."""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.two_view import features, match
from styl3r_cli.gaussians import FloatArray
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


def match_views(images: FloatArray, threads: int | None = None) -> list[Matches]:
    """Every two views' matches. Same pictures, same matches, at any number of threads.

    Args:
        images: (N, 3, H, W) sRGB in [0, 1].
        threads: None for every core.
    """
    pictures = (images.transpose(0, 2, 3, 1) * 255).round().clip(0, 255).astype(np.uint8)
    found = in_threads(features, list(pictures), threads)

    def look(pair: tuple[int, int]) -> Matches:
        first, second = pair
        return Matches(first, second, match(found[first], found[second]))

    return in_threads(look, list(combinations(range(len(pictures)), 2)), threads)
