"""A large folder of paintings (WikiArt: a folder a genre), read from disk as they are needed."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from styl3r_cli.errors import InputError
from styl3r_cli.photos.expand import PHOTO_SUFFIXES
from styl3r_cli.photos.resize import fit_style
from styl3r_export.curriculum.pictures import HELD_OUT

# Unreadable pictures in a row after which the folder is taken to be broken.
MOST_UNREADABLE = 20


class PaintingFolder:
    """Paintings of one split; stands in for a `PictureBank` where they do not fit into memory.

    Of each genre (folder) every tenth painting in sorted order is for validation.
    """

    def __init__(self, folder: Path, *, validation: bool = False) -> None:
        """Find the pictures; none is opened yet.

        Raises:
            InputError: there is none.
        """
        genres: dict[Path, list[Path]] = {}
        for path in sorted(folder.rglob("*")):
            if path.suffix.lower() in PHOTO_SUFFIXES:
                genres.setdefault(path.parent, []).append(path)
        self.files = [
            path
            for files in genres.values()
            for number, path in enumerate(files)
            if (number % HELD_OUT == 0) == validation
        ]
        if not self.files:
            raise InputError(f"{folder}: no pictures in it (.jpg, .png, ...), or too few to split")

    def crops(self, rng: np.random.Generator, count: int, size: int) -> Float[Tensor, "n 3 h w"]:
        """Random paintings in [0, 1], each resized and cropped to its centre as the tool does."""
        return _batch([self._random(rng, size) for _ in range(count)])

    def paired(self, keys: Sequence[str], size: int) -> Float[Tensor, "n 3 h w"]:
        """For each scene its painting, the same in every epoch.

        Raises:
            InputError: one cannot be read.
        """
        return _batch([_load(self.of_scene(key), size) for key in keys])

    def of_scene(self, key: str) -> Path:
        """The painting of a scene."""
        return self.files[zlib.crc32(key.encode()) % len(self.files)]

    def _random(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """A painting that can be read: large collections have damaged files in them."""
        for attempt in range(MOST_UNREADABLE):
            try:
                return _load(self.files[rng.integers(len(self.files))], size)
            except InputError:
                if attempt == MOST_UNREADABLE - 1:
                    raise
        raise AssertionError("unreachable")


def _load(path: Path, size: int) -> np.ndarray:
    try:
        with Image.open(path) as file:
            file.draft("RGB", (size, size))  # decode JPEG at a fraction of its size
            return fit_style(file.convert("RGB"), size)
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"{path}: not a readable picture: {error}") from error


def _batch(pictures: Sequence[np.ndarray]) -> Float[Tensor, "n 3 h w"]:
    return torch.from_numpy(np.stack(pictures)).permute(0, 3, 1, 2).float() / 255
