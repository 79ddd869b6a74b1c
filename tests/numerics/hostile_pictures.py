"""Views that no photographer takes: what the network must survive."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from styl3r_cli.gaussians import FloatArray
from styl3r_cli.photos import Photos

SIDE = 128
LENS = 0.9  # focal length in widths: 58 degrees across
# Pixels that the second of two overlapping views has moved by.
SHIFT = 8


def photos_of(images: FloatArray, lens: float = LENS, centre: float = 0.5) -> Photos:
    """Views (N, 3, H, W) as if they had been read from files, seen through one lens."""
    views, _, height, width = images.shape
    k = np.float32([[lens, 0, centre], [0, lens * width / height, centre], [0, 0, 1]])
    return Photos(
        images=np.ascontiguousarray(images, dtype=np.float32),
        intrinsics=np.stack([k] * views),
        names=[f"{view}" for view in range(views)],
        paths=[Path(f"{view}") for view in range(views)],
        sizes=[(width, height)] * views,
        focal_sources=["fov"] * views,
        notes=[],
    )


def wall(height: int = SIDE, width: int = SIDE, seed: int = 0) -> FloatArray:
    """(2, 3, height, width) patches of several sizes from two places: a scene like any other."""
    from PIL import Image

    rng = np.random.default_rng(seed)
    size = (width + SHIFT, height)
    layers = [
        Image.fromarray(rng.integers(0, 256, (n, n, 3), dtype=np.uint8))
        .resize(size, Image.Resampling.BICUBIC)
        for n in (4, 12, 36)
    ]  # fmt: skip
    whole = np.mean([np.asarray(layer) for layer in layers], axis=0) / 255
    views = np.stack([whole[:, :width], whole[:, SHIFT:]])
    return np.float32(views.transpose(0, 3, 1, 2))


def flat(value: float) -> FloatArray:
    return np.full((2, 3, SIDE, SIDE), value, np.float32)


def checkers() -> FloatArray:
    """Squares of one pixel; the second view has them the other way round."""
    y, x = np.mgrid[0:SIDE, 0:SIDE]
    one = np.float32((x + y) % 2)
    return np.stack([np.stack([one] * 3), np.stack([1 - one] * 3)])


def half() -> FloatArray:
    """A black view and a white one."""
    return np.concatenate([flat(0)[:1], flat(1)[:1]])


def one_dot() -> FloatArray:
    views = flat(0)
    views[:, :, SIDE // 2, SIDE // 2] = 1
    return views


def noise() -> FloatArray:
    """Only black and white, at random, and nothing in common."""
    return np.random.default_rng(1).integers(0, 2, (2, 3, SIDE, SIDE)).astype(np.float32)


HOSTILE: dict[str, Callable[[], Photos]] = {
    "black": lambda: photos_of(flat(0)),
    "white": lambda: photos_of(flat(1)),
    "one grey": lambda: photos_of(flat(0.5)),
    "black and white": lambda: photos_of(half()),
    "one-pixel checkers": lambda: photos_of(checkers()),
    "one dot": lambda: photos_of(one_dot()),
    "saturated noise": lambda: photos_of(noise()),
    "identical views": lambda: photos_of(wall()[[0, 0]]),
    "no overlap": lambda: photos_of(np.concatenate([wall()[:1], wall(seed=9)[1:]])),
    "contrast of 1/255": lambda: photos_of(np.rint(wall() * 2 + 126) / np.float32(255)),
    "16x16 pixels": lambda: photos_of(wall(16, 16)),
    "32 times as wide as high": lambda: photos_of(wall(16, 512)),
    "16 times as high as wide": lambda: photos_of(wall(512, 32)),
    "170 degrees": lambda: photos_of(wall(), lens=0.5 / np.tan(np.radians(85))),
    "1 degree": lambda: photos_of(wall(), lens=0.5 / np.tan(np.radians(0.5))),
    "principal point outside": lambda: photos_of(wall(), centre=-1.0),
}
ORDINARY = "a wall"
"""What the others are compared with: `photos_of(wall())`."""
