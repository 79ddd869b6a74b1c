"""Rendered pictures in 8 bits: along a path of cameras, and as files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.files import atomic_write
from styl3r_cli.gaussians import FloatArray, Gaussians

Picture = NDArray[np.uint8]
Colour = tuple[float, float, float]
BLACK: Colour = (0.0, 0.0, 0.0)


def to_picture(colours: FloatArray) -> Picture:
    """(H, W, 3) sRGB floats to 8 bits: clipped to [0, 1] and rounded."""
    return np.rint(np.clip(colours, 0, 1) * 255).astype(np.uint8)


def draw_path(
    gaussians: Gaussians,
    cameras: Iterable[Camera],
    background: Colour = BLACK,
    threads: int | None = None,
    drawn: Callable[[], None] = lambda: None,
) -> Iterator[Picture]:
    """The pictures that cameras see, one at a time (they need not be in memory together).

    Args:
        gaussians: the scene.
        cameras: one per picture.
        background: sRGB in [0, 1], where no Gaussian is.
        threads: None for every core.
        drawn: called after each picture.
    """
    from styl3r_cli.splatting import render

    for camera in cameras:
        yield to_picture(render(gaussians, camera, background, threads=threads).colour)
        drawn()


def write_png(path: Path, picture: Picture) -> None:
    """Write one picture; the file appears whole or not at all.

    Raises:
        OutputError: it cannot be written.
    """
    from PIL import Image

    with atomic_write(path) as temporary:
        Image.fromarray(picture).save(temporary, format="PNG")


def enlarged(camera: Camera, side: int) -> Camera:
    """The same view with its longer side `side` pixels, at least its own; both sides even."""
    factor = max(side / max(camera.width, camera.height), 1.0)
    width, height = (2 * round(length * factor / 2) for length in (camera.width, camera.height))
    return camera.resized(width, height)
