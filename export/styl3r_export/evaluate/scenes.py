"""Scenes whose cameras are known, cropped for the network; real ones with sparse points."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.errors import InputError
from styl3r_cli.photos.resize import detail_size, fit_photo
from styl3r_export.cropping import crop_camera

# Where depth is known everywhere, every so many-th pixel of every so many-th row is compared.
DENSE_STEP = 2

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrueView:
    """One photo after the tool's crop, and what is known about it.

    Attributes:
        name: the photo's file name.
        pixels: (S, S, 3) uint8 sRGB.
        camera: true extrinsics (world-to-camera, scene units) and intrinsics of the crop.
        points: (P,) which of the scene's points are seen in the crop.
        uv: (P, 2) where, in pixels of the crop.
        depth: (P,) their view z.
        photo_size: (width, height) before the crop.
        depth_map: (S, S) view z of every pixel, nan in the sky; None where only points are known.
        detail: (D, D, 3) what `pixels` show, as the tool looks at it for features; None where there
            is no more than `pixels`.
    """

    name: str
    pixels: NDArray[np.uint8]
    camera: Camera
    points: NDArray[np.int64]
    uv: Array
    depth: Array
    photo_size: tuple[int, int]
    depth_map: Array | None = None
    detail: NDArray[np.uint8] | None = None

    @property
    def finest(self) -> NDArray[np.uint8]:
        """What features are sought in."""
        return self.pixels if self.detail is None else self.detail

    @property
    def image(self) -> NDArray[np.float32]:
        """(3, S, S) sRGB in [0, 1]."""
        return np.ascontiguousarray(self.pixels.transpose(2, 0, 1), np.float32) / np.float32(255)

    @property
    def truth(self) -> tuple[Array, Array]:
        """Where depth is known, (P, 2) pixels of the crop, and the depths (P,).

        Of all pixels (on a grid) where there is a depth map, else of the points.
        """
        if self.depth_map is None:
            return self.uv, self.depth
        grid = self.depth_map[::DENSE_STEP, ::DENSE_STEP]
        rows, columns = np.nonzero(np.isfinite(grid))
        uv = np.column_stack([columns, rows]).astype(np.float64) * DENSE_STEP + 0.5
        return uv, grid[rows, columns]


@dataclass(frozen=True)
class TrueScene:
    """A named scene: its photos in the order in which they were taken."""

    name: str
    views: list[TrueView]


def scene_folders(root: Path) -> list[Path]:
    """The scenes in a folder, by name.

    Raises:
        InputError: there is none.
    """
    folders = sorted(path.parent for path in root.glob("*/cameras.json"))
    if not folders:
        raise InputError(f"{root}: no folder in it is a scene (cameras.json, points.npz, images/)")
    return folders


def load_scene(folder: Path, size: int) -> TrueScene:
    """Read a scene: `cameras.json`, `points.npz`, `images/`; crop its photos to a square.

    Args:
        folder: of the scene.
        size: side of the crops in pixels.

    Raises:
        InputError: a file is missing or damaged.
    """
    try:
        facts = json.loads((folder / "cameras.json").read_text(encoding="utf-8"))["images"]
        with np.load(folder / "points.npz", allow_pickle=False) as archive:
            points = {name: archive[name] for name in archive.files}
        index = {str(name): k for k, name in enumerate(points["image_names"])}
        views = [
            _load_view(folder / "images" / name, fact, points, index[name], size)
            for name, fact in facts.items()
        ]
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise InputError(f"{folder}: not a scene: {error!r}") from error
    return TrueScene(folder.name, views)


def _load_view(
    path: Path, fact: dict[str, Any], points: dict[str, NDArray[Any]], index: int, size: int
) -> TrueView:
    with Image.open(path) as file:
        photo = file.convert("RGB")
    seen = points["obs_image"] == index
    ids = points["obs_point"][seen].astype(np.int64)
    uv, world = points["obs_uv"][seen].astype(np.float64), points["xyz"][ids].astype(np.float64)
    return cropped_view(path.name, photo, fact, size, ids, uv, world)


def cropped_view(
    name: str,
    photo: Image.Image,
    fact: Mapping[str, Any],
    size: int,
    ids: NDArray[np.int64] | None = None,
    uv: Array | None = None,
    world: Array | None = None,
) -> TrueView:
    """A photo and its points, cropped as the tool crops it.

    Args:
        name: of the photo.
        photo: RGB.
        fact: see `crop_camera`.
        size: side of the crop.
        ids: (P,) the points seen, if any are known.
        uv: (P, 2) where, in pixels of the frame that `fact` speaks of.
        world: (P, 3) where they are.
    """
    camera, zoom, corner = crop_camera(fact, photo.size, size)
    pixels = fit_photo(photo, (size, size)).copy()
    detail = fit_photo(photo, detail_size(photo.size, (size, size))).copy()
    if ids is None or uv is None or world is None:
        ids, uv, world = np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 3))
    uv = uv * zoom - corner
    depth = world @ camera.extrinsics[2, :3] + camera.extrinsics[2, 3]
    inside = ((uv >= 0) & (uv < size)).all(axis=1) & (depth > 0)
    truth = (ids[inside], uv[inside], depth[inside])
    return TrueView(name, pixels, camera, *truth, photo.size, detail=detail)
