"""Camera files: nerfstudio's transforms.json, in and out."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.json_values import (
    FARTHEST_CENTRE,
    NARROWEST,
    WIDEST,
    frame_size,
    is_centre,
    is_lens,
    load_object,
    number,
    rate,
    rigid,
    shown,
)
from styl3r_cli.errors import InputError
from styl3r_cli.files import atomic_write

# nerfstudio's cameras look along -z with y up (OpenGL); ours along z with y down (OpenCV).
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
LENS = ("fl_x", "fl_y", "camera_angle_x", "camera_angle_y")
DISTORTION = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
DISTORTIONS = "distortion_params"  # all of them in one list, which nerfstudio reads instead
PINHOLES = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")  # distortion apart
# Instant NGP's names of other lenses; the second coefficient, as the first of a lens may be 0.
OTHER_LENSES = ("is_fisheye", "ftheta_p1", "latlong", "equirectangular", "orthographic")
WRITTEN_MODEL = "OPENCV"  # nerfstudio's name for a perspective camera


@dataclass(frozen=True)
class CameraFile:
    """The frames of a transforms.json, in the file's order.

    Attributes:
        cameras: one per frame; the world is the file's own.
        file_paths: as many paths as the file names them, empty where it names none.
        notes: one line each on what was ignored.
        fps: frames per second, if the file says.
        loop: whether the last frame leads to the first, if the file says.
        depth_paths: as many paths of depth pictures, empty where there is none.
    """

    cameras: list[Camera]
    file_paths: list[str]
    notes: list[str]
    fps: float | None = None
    loop: bool | None = None
    depth_paths: Sequence[str] = ()


def write_transforms(path: Path, cameras: Sequence[Camera], file_paths: Sequence[str]) -> None:
    """Write cameras as nerfstudio's transforms.json.

    The matrices are camera-to-world with OpenGL camera axes; the world stays the scene's own, so
    that the file fits the scene beside it. Numbers are written with all their digits.

    Args:
        path: where to write.
        cameras: one per frame.
        file_paths: one per frame: the photo, or a name.

    Raises:
        OutputError: the file cannot be written.
    """
    frames = [frame_entry(*pair) for pair in zip(cameras, file_paths, strict=True)]
    content = {"camera_model": WRITTEN_MODEL, "frames": frames}
    with atomic_write(path) as temporary:
        temporary.write_bytes(_readable(content) + b"\n")


def _readable(content: dict[str, Any]) -> bytes:
    """JSON with letters as they are; escaped, where a file's name has bytes that are no text."""
    try:
        return json.dumps(content, indent=2, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        return json.dumps(content, indent=2).encode()


def read_transforms(source: Path | bytes, size: tuple[int, int] | None = None) -> CameraFile:
    """Read nerfstudio's (and Instant NGP's) transforms.json.

    Intrinsics are a frame's own or the file's. Where `fl_x` is missing, `camera_angle_x` gives it;
    missing `cx` and `cy` mean the centre.

    Args:
        source: the file, or its content.
        size: (width, height) for files that do not say.

    Raises:
        InputError: the file is missing or no transforms.json, a matrix is not rigid, or a lens is
            not a perspective one.
    """
    return transforms_of(*load_object(source), size)


def transforms_of(
    name: str, content: dict[str, Any], size: tuple[int, int] | None = None
) -> CameraFile:
    """The same of a file's content, which messages call `name`."""
    frames = content.get("frames")
    if not isinstance(frames, list) or not frames:
        hint = " (a nerfstudio camera path?)" if "camera_path" in content else ""
        raise InputError(f"{name}: no 'frames'{hint}; expected nerfstudio's transforms.json")
    cameras, file_paths, depth_paths, distorted = [], [], [], 0
    for index, frame in enumerate(frames):
        where = f"{name}: frame {index + 1}"
        if not isinstance(frame, dict):
            raise InputError(f"{where}: not an object")
        # An angle alone is a frame's whole lens: the file's lengths would beat it, or squash it.
        own = frame.get("camera_angle_x") is not None and frame.get("fl_x") is None
        values = {**{k: v for k, v in content.items() if not (own and k in LENS)}, **frame}
        cameras.append(_camera(values, size, where))
        file_paths.append(str(frame.get("file_path", "")))
        depth_paths.append(str(frame.get("depth_file_path") or ""))
        listed = values.get(DISTORTIONS)
        distorted += any(number(values, key, where) for key in DISTORTION) or (
            isinstance(listed, list) and any(listed)
        )
    notes = []
    if distorted:
        notes.append(f"{name}: lens distortion in {distorted} frames is ignored; undistort first")
    fps, loop = rate(content, name), content.get("is_cycle")
    fps = fps if fps and fps > 0 else None
    loop = loop if isinstance(loop, bool) else None
    return CameraFile(cameras, file_paths, notes, fps, loop, depth_paths)


def frame_entry(camera: Camera, file_path: str) -> dict[str, Any]:
    """One camera as a frame of the file: camera-to-world, and its own intrinsics."""
    matrix = np.linalg.inv(camera.extrinsics) @ OPENGL_FROM_OPENCV
    return {
        "file_path": file_path,
        "fl_x": float(camera.fx),
        "fl_y": float(camera.fy),
        "cx": float(camera.cx),
        "cy": float(camera.cy),
        "w": int(camera.width),
        "h": int(camera.height),
        "transform_matrix": (matrix + 0.0).tolist(),  # + 0.0 turns -0.0 into 0.0
    }


def _camera(values: dict[str, Any], size: tuple[int, int] | None, where: str) -> Camera:
    model = values.get("camera_model", WRITTEN_MODEL)
    others = [f"'{lens}'" for lens in OTHER_LENSES if values.get(lens)]
    if model not in PINHOLES or others:
        kind = others[0] if others else f"camera_model {shown(model)}"
        raise InputError(f"{where}: {kind} is no perspective camera; undistort it")
    width, height = _size(values, size, where)
    fx = _focal(values, "fl_x", "camera_angle_x", width, where)
    fy = _focal(values, "fl_y", "camera_angle_y", height, where)
    if fx is None and fy is None:
        raise InputError(f"{where}: no focal length ('fl_x' or 'camera_angle_x')")
    cx, cy = _centre(values, "cx", width, where), _centre(values, "cy", height, where)
    pose = rigid(values.get("transform_matrix"), where)
    return Camera(
        extrinsics=np.linalg.inv(pose @ OPENGL_FROM_OPENCV).astype(np.float64),
        fx=fx or fy or 0.0,
        fy=fy or fx or 0.0,
        cx=cx,
        cy=cy,
        width=width,
        height=height,
    )


def _size(values: dict[str, Any], size: tuple[int, int] | None, where: str) -> tuple[int, int]:
    width, height = number(values, "w", where), number(values, "h", where)
    if width is None or height is None:
        if size is None:
            advice = "add the pictures' size to the file, or give render a --size"
            raise InputError(f"{where}: no 'w' and 'h'; {advice}")
        return size
    found = frame_size(width, height)
    if found is None:
        raise InputError(f"{where}: 'w' and 'h' are {width:g} and {height:g}, not a picture's size")
    return found


def _centre(values: dict[str, Any], key: str, side: float, where: str) -> float:
    centre = number(values, key, where)
    if centre is not None and not is_centre(centre, side):
        raise InputError(
            f"{where}: '{key}' is {centre:g}, more than {FARTHEST_CENTRE} frames of {side:g} "
            "pixels outside of the frame"
        )
    return side / 2 if centre is None else centre


def _focal(
    values: dict[str, Any], key: str, angle_key: str, side: float, where: str
) -> float | None:
    focal, angle = number(values, key, where), number(values, angle_key, where)
    if focal is None and angle is not None:
        if not 0 < angle < math.pi:
            raise InputError(f"{where}: '{angle_key}' is {angle:g}, not an angle in radians")
        focal = side / 2 / math.tan(angle / 2)
    if focal is not None and not is_lens(focal, side):
        raise InputError(
            f"{where}: '{key}' is {focal:g}, not a focal length in pixels: "
            f"{NARROWEST:g} to {WIDEST:g} degrees can be drawn"
        )
    return focal
