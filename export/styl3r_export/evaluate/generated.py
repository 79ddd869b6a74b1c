"""Generated scenes of a seed that training has not seen: cameras and depth are exact."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.errors import InputError
from styl3r_cli.photos.resize import fit_photo
from styl3r_export.cropping import crop_camera
from styl3r_export.evaluate.scenes import TrueScene, TrueView
from styl3r_export.scenes.shards import Shard, open_shard, shard_paths

# Every so many-th pixel of a view, both ways, is a point whose whereabouts in the others are known.
POINT_STEP = 8
# A point is seen where the depth map says so to this relative precision: twice what a pixel of a
# surface seen at 75 degrees spans at 256 pixels across.
SEEN = 0.03

Array = NDArray[np.float64]


def generated_scenes(folder: Path, size: int) -> Iterator[tuple[str, Callable[[], TrueScene]]]:
    """Name of each scene in a folder of shards, and what reads it; shard by shard.

    Raises:
        InputError: there is no shard, or one is damaged.
    """
    paths = shard_paths(folder)
    if not paths:
        raise InputError(
            f"{folder}: no scene shards; make some: python -m styl3r_export.scenes "
            f"--out {folder} --seed 1000 --views 10"
        )
    for path in paths:
        try:
            shard = open_shard(path)
            meta = json.loads((path / "meta.json").read_text(encoding="utf-8"))
            names = [
                f"{kind}, seed {meta['seed']}, {meta['index']}-{k}"
                for k, kind in enumerate(meta["kinds"])
            ]
            if len(names) != len(shard.images):
                raise ValueError(f"{len(names)} kinds of {len(shard.images)} scenes")
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(f"{path}: not a scene shard: {error!r}") from error
        for k, name in enumerate(names):
            yield name, partial(load_generated, shard, k, name, size)


def load_generated(shard: Shard, index: int, name: str, size: int) -> TrueScene:
    """One scene of a shard, cropped to a square as photos are.

    Points are pixels of each view, at even steps, found again in the others by projection.
    """
    height, width = shard.depth.shape[-2:]
    cameras, photos, depths = [], [], []
    for view in range(shard.images.shape[1]):
        k = shard.intrinsics[index, view].astype(np.float64) * [[width], [height], [1]]
        lens = {"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2]}
        w2c = shard.extrinsics[index, view].astype(np.float64)
        fact = lens | {"w2c": w2c, "width": width, "height": height}
        camera, zoom, corner = crop_camera(fact, (width, height), size)
        pixels = np.ascontiguousarray(shard.images[index, view].transpose(1, 2, 0))
        photos.append(fit_photo(Image.fromarray(pixels), (size, size)).copy())
        depth = shard.depth[index, view].astype(np.float64)
        depth[np.asarray(shard.sky[index, view])] = np.nan
        centres = np.arange(size) + 0.5
        columns, rows = (((centres + corner[a]) / zoom[a]).astype(int) for a in (0, 1))
        depths.append(depth[rows[:, None], columns])
        cameras.append(camera)
    world = np.concatenate([grid_points(c, d) for c, d in zip(cameras, depths, strict=True)])
    views = []
    for view, (camera, photo, depth) in enumerate(zip(cameras, photos, depths, strict=True)):
        ids, uv, z = seen_points(camera, depth, world)
        views.append(
            TrueView(f"{view}", photo, camera, ids, uv, z, (width, height), depth_map=depth)
        )
    return TrueScene(name, views)


def grid_points(camera: Camera, depth: Array) -> Array:
    """(P, 3) world: what every POINT_STEP-th pixel sees, the sky left out."""
    starts = np.arange(POINT_STEP // 2, camera.width, POINT_STEP)
    rows, columns = (a.ravel() for a in np.meshgrid(starts, starts, indexing="ij"))
    solid = np.isfinite(depth[rows, columns])
    rows, columns = rows[solid], columns[solid]
    z = depth[rows, columns]
    x = (columns + 0.5 - camera.cx) / camera.fx * z
    y = (rows + 0.5 - camera.cy) / camera.fy * z
    here = np.column_stack([x, y, z])
    return (here - camera.extrinsics[:3, 3]) @ camera.extrinsics[:3, :3]


def seen_points(
    camera: Camera, depth: Array, world: Array
) -> tuple[NDArray[np.int64], Array, Array]:
    """Which points a view sees (P,), where (P, 2), and at what depth (P,)."""
    here = world @ camera.extrinsics[:3, :3].T + camera.extrinsics[:3, 3]
    z = np.where(here[:, 2] > 0, here[:, 2], np.nan)
    uv = here[:, :2] / z[:, None] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    size = (camera.width, camera.height)
    inside = np.flatnonzero(((uv >= 0) & (uv < size)).all(axis=1))
    columns, rows = uv[inside].astype(int).T
    true = depth[rows, columns]
    ids = inside[np.abs(z[inside] - true) < SEEN * true]  # never in the sky, which is nan
    return ids, uv[ids], z[ids]
