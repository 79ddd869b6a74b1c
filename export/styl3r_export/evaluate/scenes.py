"""Real scenes with cameras and sparse points by structure from motion, cropped for the network."""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.errors import InputError
from styl3r_cli.photos.resize import fit_photo


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
    """

    name: str
    pixels: NDArray[np.uint8]
    camera: Camera
    points: NDArray[np.int64]
    uv: NDArray[np.float64]
    depth: NDArray[np.float64]
    photo_size: tuple[int, int]

    @property
    def image(self) -> NDArray[np.float32]:
        """(3, S, S) sRGB in [0, 1]."""
        return np.ascontiguousarray(self.pixels.transpose(2, 0, 1), np.float32) / np.float32(255)


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
    camera, zoom, corner = crop_camera(fact, photo.size, size)
    seen = points["obs_image"] == index
    ids = points["obs_point"][seen].astype(np.int64)
    uv = points["obs_uv"][seen].astype(np.float64) * zoom - corner
    world = points["xyz"][ids].astype(np.float64)
    depth = world @ camera.extrinsics[2, :3] + camera.extrinsics[2, 3]
    inside = ((uv >= 0) & (uv < size)).all(axis=1) & (depth > 0)
    pixels = fit_photo(photo, (size, size)).copy()
    return TrueView(path.name, pixels, camera, ids[inside], uv[inside], depth[inside], photo.size)


def crop_camera(
    fact: dict[str, Any], photo_size: tuple[int, int], size: int
) -> tuple[Camera, NDArray[np.float64], NDArray[np.float64]]:
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
