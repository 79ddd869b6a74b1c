"""Nerfstudio's camera paths, in and out: the camera of every frame of a video."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.json_values import (
    NARROWEST,
    WIDEST,
    frame_size,
    is_lens,
    load_object,
    number,
    rate,
    rigid,
    shown,
)
from styl3r_cli.cameras.transforms import (
    OPENGL_FROM_OPENCV,
    WRITTEN_MODEL,
    CameraFile,
    frame_entry,
    transforms_of,
)
from styl3r_cli.errors import InputError
from styl3r_cli.files import atomic_write

PERSPECTIVE = "perspective"


def read_cameras(source: Path, size: tuple[int, int] | None = None) -> CameraFile:
    """Read a transforms.json or a camera path, whichever the file is.

    Raises:
        InputError: it is neither, or something in it is wrong.
    """
    name, content = load_object(source)  # once: a pipe has nothing the second time
    if "frames" not in content and "camera_path" in content:
        return _camera_path_of(name, content)
    return transforms_of(name, content, size)


def read_camera_path(source: Path | bytes) -> CameraFile:
    """Read nerfstudio's camera path, as its viewer and its Blender add-on write it.

    Matrices are camera-to-world with OpenGL camera axes, 16 numbers by rows; `fov` is the vertical
    field of view in degrees.

    Raises:
        InputError: the file is missing or no camera path, has no frames, or a value is wrong.
    """
    return _camera_path_of(*load_object(source))


def _camera_path_of(name: str, content: dict[str, Any]) -> CameraFile:
    entries = content.get("camera_path")
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{name}: no frames in 'camera_path'; expected nerfstudio's camera path")
    kind = content.get("camera_type", PERSPECTIVE)
    if kind != PERSPECTIVE:
        raise InputError(
            f"{name}: camera_type {shown(kind)}; only perspective cameras can be drawn"
        )
    sides = (number(content, f"render_{side}", name) for side in ("width", "height"))
    size = frame_size(*(side and math.floor(side) for side in sides))
    if size is None:
        raise InputError(f"{name}: 'render_width' and 'render_height' are no picture's size")
    cameras = []
    for index, entry in enumerate(entries):
        where = f"{name}: frame {index + 1}"
        if not isinstance(entry, dict):
            raise InputError(f"{where}: not an object")
        cameras.append(_camera(entry, *size, where))
    fps = rate(content, name)
    if fps is not None and fps <= 0:
        raise InputError(f"{name}: 'fps' is {fps:g}; a rate is above 0")
    loop = content.get("is_cycle")
    return CameraFile(
        cameras, [""] * len(cameras), [], fps, loop if isinstance(loop, bool) else None
    )


def write_camera_path(path: Path, cameras: Sequence[Camera], fps: float, loop: bool) -> None:
    """Write the cameras of a video, for nerfstudio and for every reader of transforms.json.

    The one file is both: `camera_path` is what `ns-render camera-path` reads, and `frames` has the
    same cameras with all their intrinsics. The world is the scene's own.

    Args:
        path: where to write.
        cameras: one per frame, at least one; all of one size.
        fps: frames per second.
        loop: whether the last frame leads to the first.

    Raises:
        OutputError: the file cannot be written.
    """
    first = cameras[0]
    content = {
        "camera_model": WRITTEN_MODEL,
        "frames": [frame_entry(camera, f"{index:05d}") for index, camera in enumerate(cameras)],
        "camera_type": PERSPECTIVE,
        "render_width": first.width,
        "render_height": first.height,
        "fps": fps,
        "seconds": len(cameras) / fps,
        "is_cycle": loop,
        "keyframes": [],
        "camera_path": [_entry(camera) for camera in cameras],
    }
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", "utf-8")


def _entry(camera: Camera) -> dict[str, Any]:
    matrix = np.linalg.inv(camera.extrinsics) @ OPENGL_FROM_OPENCV + 0.0
    fov = 2 * math.degrees(math.atan(camera.height / 2 / camera.fy))
    return {
        "camera_to_world": matrix.ravel().tolist(),
        "fov": fov,
        "aspect": camera.width / camera.height,
    }


def _camera(entry: dict[str, Any], width: int, height: int, where: str) -> Camera:
    matrix = entry.get("camera_to_world")
    if isinstance(matrix, list) and len(matrix) == 16:  # rows one after the other
        matrix = [matrix[row : row + 4] for row in range(0, 16, 4)]
    pose = rigid(matrix, where, "camera_to_world")
    fov = math.radians(number(entry, "fov", where) or 0.0)
    focal = height / 2 / math.tan(fov / 2) if 0 < fov < math.pi else 0.0
    if not is_lens(focal, height):
        raise InputError(f"{where}: 'fov' is no angle from {NARROWEST:g} to {WIDEST:g} degrees")
    extrinsics = np.linalg.inv(pose @ OPENGL_FROM_OPENCV).astype(np.float64)
    return Camera(extrinsics, focal, focal, width / 2, height / 2, width, height)
