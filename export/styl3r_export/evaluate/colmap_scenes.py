"""Scenes in COLMAP's layout (Tanks and Temples as it is used for splatting), as true scenes."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from styl3r_cli.errors import InputError
from styl3r_export.evaluate.colmap import Lens, Photo, model_folder, read_reconstruction
from styl3r_export.evaluate.scenes import TrueScene, TrueView, cropped_view
from styl3r_export.model.rotations import rotation_matrix

# Which of a model's parameters are fx, fy, cx and cy, and which OpenCV's distortion; models that
# are not here bend straight lines in ways that OpenCV's `undistort` does not know.
LAYOUTS: dict[str, tuple[tuple[int, int, int, int], tuple[int, ...]]] = {
    "SIMPLE_PINHOLE": ((0, 0, 1, 2), ()),
    "PINHOLE": ((0, 1, 2, 3), ()),
    "SIMPLE_RADIAL": ((0, 0, 1, 2), (3,)),
    "RADIAL": ((0, 0, 1, 2), (3, 4)),
    "OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7)),
    "FULL_OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7, 8, 9, 10, 11)),
}
DISTORTION_NUMBERS = (4, 5, 8)  # that OpenCV takes

Array = NDArray[np.float64]


def colmap_folders(root: Path) -> list[Path]:
    """The folder itself if it is a scene, else the scenes in it, by name.

    Raises:
        InputError: there is none.
    """
    if model_folder(root) is not None:
        return [root]
    folders = sorted(path for path in root.iterdir() if path.is_dir() and model_folder(path))
    if not folders:
        raise InputError(
            f"{root}: neither a COLMAP scene nor a folder of such "
            "(sparse/0/cameras.bin, images.bin, points3D.bin beside images/)"
        )
    return folders


def load_colmap(scene: Path, size: int) -> TrueScene:
    """Read a scene's reconstruction and photos, undistort them, and crop them to squares.

    Args:
        scene: holds `images/` and `sparse/0/`.
        size: side of the crops.

    Raises:
        InputError: a file is missing or damaged, or a lens is of a kind that is not supported.
    """
    folder = model_folder(scene)
    if folder is None:
        raise InputError(f"{scene}: not a COLMAP scene")
    found = read_reconstruction(folder)
    numbers = {number: index for index, number in enumerate(found.points)}
    world = np.array(list(found.points.values())).reshape(-1, 3)
    views = []
    for photo in found.photos:
        lens = found.lenses.get(photo.lens)
        if lens is None:
            raise InputError(f"{folder}: photo {photo.name} has no camera {photo.lens}")
        seen = np.array([point in numbers for point in photo.points.tolist()], bool)
        ids = np.array([numbers[point] for point in photo.points[seen].tolist()], np.int64)
        views.append(_view(scene, photo, lens, size, ids, photo.uv[seen], world[ids]))
    return TrueScene(scene.name, views)


def _view(
    scene: Path, photo: Photo, lens: Lens, size: int, ids: NDArray[np.int64], uv: Array,
    world: Array,
) -> TrueView:  # fmt: skip
    """One photo as if a pinhole camera of the same focal length had taken it."""
    matrix, distortion = pinhole(lens, scene / photo.name)
    try:
        with Image.open(scene / "images" / photo.name) as file:
            picture = file.convert("RGB")
    except (OSError, Image.DecompressionBombError) as error:
        raise InputError(f"{scene}: photo images/{photo.name} cannot be read: {error}") from error
    if distortion.any():
        zoom = np.array([picture.width / lens.width, picture.height / lens.height, 1])
        resized = shifted(matrix * zoom[:, None], -0.5)
        pixels = cv2.undistort(np.asarray(picture), resized, distortion)
        picture = Image.fromarray(pixels.astype(np.uint8))
        if len(uv):
            straight = cv2.undistortPoints(uv[:, None], matrix, distortion, P=matrix)
            uv = np.asarray(straight, np.float64)[:, 0]
    turn = torch.from_numpy(photo.quaternion / np.linalg.norm(photo.quaternion))
    w2c = np.eye(4)
    w2c[:3, :3], w2c[:3, 3] = rotation_matrix(turn).numpy(), photo.translation
    fact = {"fx": matrix[0, 0], "fy": matrix[1, 1], "cx": matrix[0, 2], "cy": matrix[1, 2]}
    fact |= {"width": lens.width, "height": lens.height}
    return cropped_view(photo.name, picture, fact | {"w2c": w2c}, size, ids, uv, world)


def pinhole(lens: Lens, where: Path) -> tuple[Array, Array]:
    """Intrinsics (3, 3) in pixels, and OpenCV's distortion coefficients.

    Raises:
        InputError: the lens is of a kind that is not supported.
    """
    if lens.model not in LAYOUTS:
        raise InputError(
            f"{where}: a {lens.model} lens; run `colmap image_undistorter` on the scene first"
        )
    places, bends = LAYOUTS[lens.model]
    fx, fy, cx, cy = (lens.parameters[place] for place in places)
    coefficients = [lens.parameters[place] for place in bends]
    length = next(number for number in DISTORTION_NUMBERS if number >= len(bends))
    distortion = np.array(coefficients + [0.0] * (length - len(bends)))
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64), distortion


def shifted(matrix: Array, shift: float) -> Array:
    """The same camera where pixel coordinates start elsewhere: OpenCV's are half a pixel less."""
    moved = matrix.copy()
    moved[:2, 2] += shift
    return moved
