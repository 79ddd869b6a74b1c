"""A photo's true camera after the tool's resize and centre crop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera

Array = NDArray[np.float64]


def crop_camera(
    fact: Mapping[str, Any], photo_size: tuple[int, int], size: int
) -> tuple[Camera, Array, Array]:
    """A photo's camera after `fit_photo`, exact to the half pixel that an odd margin shifts by.

    Args:
        fact: `w2c`, `fx`, `fy`, `cx`, `cy` in pixels of a frame of `width` x `height`.
        photo_size: (width, height) of the photo.
        size: side of the crop.

    Returns:
        The camera, and the factors (2,) and the corner (2,) that take stored pixels to the
        crop's: `uv * factors - corner`.
    """
    factor = max(size / photo_size[1], size / photo_size[0])
    resized = np.array([round(photo_size[0] * factor), round(photo_size[1] * factor)])
    zoom = resized / np.array([fact["width"], fact["height"]], np.float64)
    corner = ((resized - size) // 2).astype(np.float64)
    cx, cy = (float(c) for c in np.array([fact["cx"], fact["cy"]]) * zoom - corner)
    fx, fy = (float(f) for f in np.array([fact["fx"], fact["fy"]]) * zoom)
    camera = Camera(np.array(fact["w2c"], np.float64), fx, fy, cx, cy, size, size)
    return camera, zoom, corner
