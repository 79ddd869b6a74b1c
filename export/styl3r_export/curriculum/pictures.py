"""Folders of pictures: paintings as styles, and photographs as flat scenes."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from styl3r_export.curriculum.data import Batch

# Every tenth picture of a sorted folder is kept for validation.
HELD_OUT = 10
# Largest shift between two crops of a photograph, as a fraction of the crop.
MAX_SHIFT = 0.3
# Normalised focal length given to flat scenes: a phone's, roughly.
FLAT_FOCAL = 1.0


def training_pictures(folder: Path, sources: Path | None = None) -> list[Path]:
    """Pictures of a folder that may be trained on.

    Args:
        folder: holds the pictures.
        sources: a SOURCES.csv whose column `artwork_licence_status` says which are in the
            public domain; without it, all are taken but the held-out ones.
    """
    suffixes = {".jpg", ".jpeg", ".png", ".webp"}
    files = sorted(p for p in folder.rglob("*") if p.suffix.lower() in suffixes)
    kept = [p for i, p in enumerate(files) if i % HELD_OUT != 0]
    if sources is None:
        return kept
    with sources.open(newline="") as file:
        free = {
            Path(row["file"]).name
            for row in csv.DictReader(file)
            if row["artwork_licence_status"].startswith("artwork public domain")
        }
    return [p for p in kept if p.name in free]


class PictureBank:
    """Pictures in memory, shorter side `side`, drawn as random square crops."""

    def __init__(self, files: list[Path], side: int) -> None:
        if not files:
            raise FileNotFoundError("no pictures to train on")
        self.pictures = [_load(path, side) for path in files]
        self.side = side

    def crop(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """One random crop, (size, size, 3) uint8, mirrored half of the time."""
        picture = self.pictures[rng.integers(len(self.pictures))]
        y = rng.integers(picture.shape[0] - size + 1)
        x = rng.integers(picture.shape[1] - size + 1)
        crop = picture[y : y + size, x : x + size]
        return crop[:, ::-1] if rng.random() < 0.5 else crop

    def crops(self, rng: np.random.Generator, count: int, size: int) -> Float[Tensor, "n 3 h w"]:
        """Several crops as a batch in [0, 1]."""
        stacked = np.stack([self.crop(rng, size) for _ in range(count)])
        return torch.from_numpy(stacked).permute(0, 3, 1, 2).float() / 255

    def flat_scene(self, rng: np.random.Generator, size: int) -> tuple[np.ndarray, np.ndarray]:
        """Two overlapping crops of one photograph, and the second's shift in pixels (x, y)."""
        reach = int(size * MAX_SHIFT)
        picture = self.pictures[rng.integers(len(self.pictures))]
        height, width = picture.shape[:2]
        y0, x0 = rng.integers(height - size + 1), rng.integers(width - size + 1)
        y1 = int(np.clip(y0 + rng.integers(-reach, reach + 1), 0, height - size))
        x1 = int(np.clip(x0 + rng.integers(-reach, reach + 1), 0, width - size))
        crops = np.stack(
            [picture[y0 : y0 + size, x0 : x0 + size], picture[y1 : y1 + size, x1 : x1 + size]]
        )
        return crops, np.array([x1 - x0, y1 - y0], np.float32)


def _load(path: Path, side: int) -> np.ndarray:
    with Image.open(path) as image:
        rgb = image.convert("RGB")
        factor = side / min(rgb.size)
        size = (max(side, round(rgb.width * factor)), max(side, round(rgb.height * factor)))
        return np.asarray(rgb.resize(size, Image.Resampling.LANCZOS))


def flat_batches(bank: PictureBank, seed: int, scenes: int, size: int) -> Iterator[Batch]:
    """Endless batches of photographs as two views of a plane at depth 1.

    A shift of the crop is a sideways step of the camera, so that colours of one place can be
    compared between views just as in generated scenes, on the statistics of real photographs.
    """
    rng = np.random.default_rng(seed)
    lens = torch.tensor([[FLAT_FOCAL, 0, 0.5], [0, FLAT_FOCAL, 0.5], [0, 0, 1]])
    while True:
        crops, shifts = zip(*(bank.flat_scene(rng, size) for _ in range(scenes)), strict=True)
        images = torch.from_numpy(np.stack(crops)).permute(0, 1, 4, 2, 3).float() / 255
        extrinsics = torch.eye(4).repeat(scenes, 2, 1, 1)
        extrinsics[:, 1, :2, 3] = -torch.from_numpy(np.stack(shifts)) / (FLAT_FOCAL * size)
        depth = torch.ones(scenes, 2, size, size)
        yield Batch(images, depth, extrinsics, lens.repeat(scenes, 2, 1, 1))
