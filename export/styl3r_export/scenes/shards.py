"""Scenes on disk: one folder per shard, one memory-mappable .npy per field."""

import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.generate import SceneViews, generate
from styl3r_export.scenes.textures import TextureBank

#: Scenes in one shard: 64 of 6 views at 256x256 are about 130 MB.
SHARD_SCENES = 64
#: Raised when the arrays' meaning changes, so that old shards are not mixed with new ones.
FORMAT = 1


@dataclass(frozen=True)
class Shard:
    """n scenes of V views. Lengths are in units of view 0's median depth (sky left out).

    Attributes:
        images: (n, V, 3, H, W) uint8 sRGB.
        depth: (n, V, H, W) float16 camera z depth.
        sky: (n, V, H, W) bool.
        extrinsics: (n, V, 4, 4) float32 world-to-camera; view 0 is the identity.
        intrinsics: (n, V, 3, 3) float32, normalised.
    """

    images: NDArray[np.uint8]
    depth: NDArray[np.float16]
    sky: NDArray[np.bool_]
    extrinsics: NDArray[np.float32]
    intrinsics: NDArray[np.float32]


@dataclass(frozen=True)
class Plan:
    """Which scenes go into a folder of shards."""

    seed: int
    views: int
    size: tuple[int, int]
    scenes: int = SHARD_SCENES


def normalised(views: SceneViews) -> dict[str, NDArray]:
    """One scene's fields as a shard stores them."""
    near = views.depth[0][~views.sky[0]]
    unit = float(np.median(near)) if near.size else float(np.median(views.depth[0]))
    extrinsics = views.extrinsics.copy()
    extrinsics[:, :3, 3] /= unit
    return {
        "images": (views.images * 255 + 0.5).astype(np.uint8),
        "depth": np.minimum(views.depth / unit, np.finfo(np.float16).max).astype(np.float16),
        "sky": views.sky,
        "extrinsics": extrinsics.astype(np.float32),
        "intrinsics": views.intrinsics.astype(np.float32),
    }


def shard_path(folder: Path, index: int) -> Path:
    """Where a shard lies."""
    return folder / f"shard_{index:05d}"


def write_shard(folder: Path, index: int, plan: Plan, textures: TextureBank) -> bool:
    """Generate one shard unless it is already there; it appears whole or not at all.

    Returns:
        Whether anything had to be made.
    """
    target = shard_path(folder, index)
    if target.exists():
        return False
    scenes, kinds = [], []
    for k in range(plan.scenes):
        # Seeds are spread so that folders of other seeds share no scene with this one.
        seed = plan.seed * 10_000_000 + index * plan.scenes + k
        views = generate(seed, plan.views, plan.size, textures)
        scenes.append(normalised(views))
        kinds.append(views.kind)
    partial = target.with_name(f".{target.name}.{os.getpid()}")
    partial.mkdir(parents=True)
    try:
        for name in scenes[0]:
            np.save(partial / f"{name}.npy", np.stack([scene[name] for scene in scenes]))
        meta = {"format": FORMAT, "seed": plan.seed, "index": index, "kinds": kinds}
        (partial / "meta.json").write_text(json.dumps(meta))
        partial.rename(target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return True


def open_shard(path: Path) -> Shard:
    """Map a shard into memory; nothing is read before it is used.

    Raises:
        ValueError: the shard was written in another format.
    """
    meta = json.loads((path / "meta.json").read_text())
    if meta["format"] != FORMAT:
        raise ValueError(f"{path}: format {meta['format']}, expected {FORMAT}; generate it anew")
    names = Shard.__dataclass_fields__
    return Shard(**{name: np.load(path / f"{name}.npy", mmap_mode="r") for name in names})


def shard_paths(folder: Path) -> list[Path]:
    """All finished shards of a folder, in order."""
    return sorted(p for p in folder.iterdir() if p.is_dir() and p.name.startswith("shard_"))
