"""The bank of pictures that surfaces are covered with, and the mip pyramids they are read from."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.patterns import SIDE, draw_pattern

#: Texture levels from SIDE down to one pixel, and where each begins in a flattened pyramid.
LEVELS = SIDE.bit_length()
LEVEL_STARTS = np.cumsum([0] + [(SIDE >> k) ** 2 for k in range(LEVELS)])[:LEVELS]
PYRAMID_TEXELS = int(sum((SIDE >> k) ** 2 for k in range(LEVELS)))
#: Pictures that a bank draws procedurally: enough that one scene seldom repeats another's.
PATTERN_COUNT = 160
PICTURE_SUFFIXES = {".jpg", ".jpeg", ".png", ".webp"}


class TextureBank:
    """Square sRGB pictures, photos and procedural patterns.

    Attributes:
        photos: (P, 256, 256, 3) uint8, may be empty.
        patterns: (Q, 256, 256, 3) uint8.
    """

    def __init__(self, photos: NDArray[np.uint8], patterns: NDArray[np.uint8]) -> None:
        self.photos, self.patterns = photos, patterns

    @classmethod
    def procedural(cls, seed: int, count: int | None = None) -> "TextureBank":
        """Patterns only (PATTERN_COUNT of them, or count): no picture that anyone else made."""
        rng = np.random.default_rng([seed, 7])
        patterns = np.stack([draw_pattern(rng) for _ in range(count or PATTERN_COUNT)])
        return cls(np.zeros((0, SIDE, SIDE, 3), np.uint8), patterns)

    @classmethod
    def from_folder(cls, folder: str | Path, seed: int = 0) -> "TextureBank":
        """All pictures of a folder (by name), squeezed to squares, beside the patterns.

        Raises:
            FileNotFoundError: the folder holds no readable picture.
        """
        paths = sorted(p for p in Path(folder).iterdir() if p.suffix.lower() in PICTURE_SUFFIXES)
        decoded = [cv2.imread(str(path), cv2.IMREAD_COLOR) for path in paths]
        photos = [
            cv2.resize(p, (SIDE, SIDE), interpolation=cv2.INTER_AREA)[..., ::-1]
            for p in decoded
            if p is not None
        ]
        if not photos:
            raise FileNotFoundError(f"{folder}: no picture in this folder")
        return cls(np.stack(photos), cls.procedural(seed).patterns)

    def draw(self, rng: np.random.Generator, photo: float = 0.65) -> NDArray[np.uint8]:
        """A random crop of a random picture with its colours varied, (256, 256, 3) uint8.

        Args:
            rng: random source.
            photo: probability of a photo where the bank has any.
        """
        if len(self.photos) and rng.random() < photo:
            picture = self.photos[rng.integers(len(self.photos))]
            side = int(SIDE * rng.uniform(0.35, 1.0))
            y, x = rng.integers(0, SIDE - side + 1, 2)
            picture = cv2.resize(picture[y : y + side, x : x + side], (SIDE, SIDE))
        else:
            picture = self.patterns[rng.integers(len(self.patterns))]
        if rng.random() < 0.5:
            picture = picture[:, ::-1]
        return _recoloured(rng, picture)


def _recoloured(rng: np.random.Generator, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Saturation, contrast, tint and brightness varied, sometimes strongly."""
    saturation, contrast = rng.uniform(0.25, 1.25), rng.uniform(0.5, 1.2)
    strength = 0.3 if rng.random() < 0.12 else 0.08
    gain = np.exp(rng.normal(0, strength, 3)) * rng.uniform(0.75, 1.3)
    mix = saturation * np.eye(3) + (1 - saturation) / 3  # about each pixel's own grey
    mean = np.array(cv2.mean(picture)[:3])
    matrix = np.empty((3, 4))
    matrix[:, :3] = gain[:, None] * contrast * mix
    matrix[:, 3] = gain * (1 - contrast) * (mix @ mean)
    return np.asarray(cv2.transform(np.ascontiguousarray(picture), matrix), np.uint8)


def pyramids(pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """(K, texels, 3): each picture's mip levels, one after another."""
    out = np.empty((len(pictures), PYRAMID_TEXELS, 3), np.uint8)
    for k, picture in enumerate(pictures):
        level = np.ascontiguousarray(picture)
        for start in LEVEL_STARTS:
            out[k, start : start + level.shape[0] ** 2] = level.reshape(-1, 3)
            half = max(level.shape[0] // 2, 1)
            smaller = cv2.resize(level, (half, half), interpolation=cv2.INTER_AREA)
            level = np.asarray(smaller, np.uint8)
    return out
