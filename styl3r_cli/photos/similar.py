"""Photos that show the same: they carry no parallax, so the user should know."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

THUMBNAIL = 32  # cells along each side; averages away compression and sensor noise
# Mean absolute difference of thumbnails, in 8-bit steps. Saving a photo again as a poor JPEG
# (quality 50) stays below 1.6; neighbouring views of 32 real scenes are at least 8.6 apart.
NEARLY_IDENTICAL = 2.5


def similar_pairs(pictures: list[NDArray[np.uint8]], names: list[str]) -> list[str]:
    """One note per photo that repeats an earlier one.

    Args:
        pictures: (H, W, 3) uint8 crops, all of one size.
        names: as many names.
    """
    notes = []
    thumbnails = [_thumbnail(picture) for picture in pictures]
    for later in range(len(pictures)):
        for earlier in range(later):
            if np.array_equal(pictures[earlier], pictures[later]):
                how = "are identical"
            elif np.abs(thumbnails[earlier] - thumbnails[later]).mean() < NEARLY_IDENTICAL:
                how = "are nearly identical"
            else:
                continue
            notes.append(f"{names[earlier]} and {names[later]} {how}: no parallax between them")
            break
    return notes


def _thumbnail(picture: NDArray[np.uint8]) -> NDArray[np.float64]:
    """(32, 32, 3) means over equal cells (a remainder at the right and bottom is left out)."""
    height, width = (max(side // THUMBNAIL, 1) for side in picture.shape[:2])
    rows, columns = picture.shape[0] // height, picture.shape[1] // width
    cells = picture[: rows * height, : columns * width].astype(np.float64)
    return cells.reshape(rows, height, columns, width, 3).mean(axis=(1, 3))
