"""Shards of generated scenes as training batches, with the augmentations that cost nothing."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

# Fields of a shard, one .npy each, the scene first.
FIELDS = ("images", "depth", "extrinsics", "intrinsics")


class Batch(NamedTuple):
    """B scenes of V views; the first view is the world, whose median depth is 1."""

    images: Float[Tensor, "batch views 3 H W"]  # sRGB in [0, 1]
    depth: Float[Tensor, "batch views H W"]  # camera z
    extrinsics: Float[Tensor, "batch views 4 4"]  # world-to-camera
    intrinsics: Float[Tensor, "batch views 3 3"]  # normalised


class Shards:
    """Memory-mapped shards in a folder; new ones are picked up as a generator writes them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.shards: dict[Path, dict[str, np.ndarray]] = {}
        self.refresh()

    def refresh(self) -> None:
        """Look for shards that have been finished since."""
        for path in sorted(p for p in self.folder.iterdir() if p.is_dir()):
            if path in self.shards or not all((path / f"{f}.npy").exists() for f in FIELDS):
                continue
            self.shards[path] = {f: np.load(path / f"{f}.npy", mmap_mode="r") for f in FIELDS}
        if not self.shards:
            raise FileNotFoundError(f"no scene shards in {self.folder}")
        self.index = [(path, i) for path, s in self.shards.items() for i in range(len(s["images"]))]

    def __len__(self) -> int:
        return len(self.index)

    def sample(self, rng: np.random.Generator, views: int) -> tuple[np.ndarray, ...]:
        """One random scene's `views` random views, the first of them re-based to the world."""
        path, i = self.index[rng.integers(len(self.index))]
        shard = self.shards[path]
        chosen = choose_views(rng, shard["images"].shape[1], views)
        return tuple(np.asarray(shard[f][i][chosen]) for f in FIELDS)


def choose_views(rng: np.random.Generator, available: int, views: int) -> np.ndarray:
    """A random run of views along the path, in walking order or against it."""
    if views == 2:
        first = rng.integers(available - 1)
        second = min(available - 1, first + rng.integers(1, available))
        chosen = np.array([first, second])
    else:
        chosen = np.sort(rng.choice(available, views, replace=False))
    return chosen[::-1].copy() if rng.random() < 0.5 else chosen


def rebase(
    depth: Float[Tensor, "batch views H W"], extrinsics: Float[Tensor, "batch views 4 4"]
) -> tuple[Tensor, Tensor]:
    """Put the world at the first view's camera, and make its median depth 1."""
    extrinsics = extrinsics @ torch.linalg.inv(extrinsics[:, :1])
    unit = depth[:, 0].flatten(1).median(dim=1).values
    extrinsics = extrinsics.clone()
    extrinsics[..., :3, 3] /= unit[:, None, None]
    return depth / unit[:, None, None, None], extrinsics


def mirror(batch: Batch) -> Batch:
    """The scene in a mirror: pictures flipped left to right, poses conjugated (spec 11)."""
    flip = torch.diag(torch.tensor([-1.0, 1.0, 1.0, 1.0]))
    intrinsics = batch.intrinsics.clone()
    intrinsics[..., 0, 2] = 1 - intrinsics[..., 0, 2]
    return Batch(
        batch.images.flip(-1), batch.depth.flip(-1), flip @ batch.extrinsics @ flip, intrinsics
    )


def recolour(images: Tensor, rng: np.random.Generator) -> Tensor:
    """One permutation and one gamma of the colour channels for all views of the batch."""
    order = torch.from_numpy(rng.permutation(3))
    gamma = torch.from_numpy(rng.uniform(0.7, 1.4, size=(1, 1, 3, 1, 1)).astype(np.float32))
    return images[:, :, order].clamp(1e-4, 1) ** gamma


def batches(
    folder: Path, seed: int, size: int, views: tuple[int, ...], *, refresh_every: int = 200
) -> Iterator[Batch]:
    """Endless batches of `size` scenes with 2, ..., views drawn anew for each batch."""
    rng = np.random.default_rng(seed)
    shards = Shards(folder)
    for step in iter(int, 1):
        if step % refresh_every == 0:
            shards.refresh()
        count = int(rng.choice(views))
        # Fewer scenes where each has more views, so that a step costs about the same.
        scenes = max(1, size * 2 // count)
        fields = zip(*(shards.sample(rng, count) for _ in range(scenes)), strict=True)
        images, depth, extrinsics, intrinsics = (torch.from_numpy(np.stack(f)) for f in fields)
        depth, extrinsics = rebase(depth.float(), extrinsics.float())
        batch = Batch(images.float() / 255, depth, extrinsics, intrinsics.float())
        batch = batch._replace(images=recolour(batch.images, rng))
        yield mirror(batch) if rng.random() < 0.5 else batch
