"""The views' cameras as text lines that travel inside a scene file."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.json_values import FARTHEST, frame_size, is_centre, is_lens, is_rotation

# Viewers read only the first kilobytes when they look for the end of a PLY header (10 KB in a
# popular one), so a camera is one short line: 8 of them are about 1.5 KB.
KEY = "camera.{}"
KEYS = re.compile(r"camera\.[0-9]+")
NUMBERS = 18  # width, height, fx, fy, cx, cy, and the upper three rows of the extrinsics
DIGITS = 8  # more than float32 has; a thousandth of a pixel in any frame


def cameras_to_metadata(cameras: Sequence[Camera]) -> dict[str, str]:
    """One entry per camera: "width height fx fy cx cy", then world-to-camera, 3x4, by rows."""
    metadata = {}
    for index, c in enumerate(cameras):
        values = [c.width, c.height, c.fx, c.fy, c.cx, c.cy, *c.extrinsics[:3].ravel()]
        metadata[KEY.format(index)] = " ".join(f"{value:.{DIGITS}g}" for value in values)
    return metadata


def cameras_from_metadata(metadata: Mapping[str, str]) -> list[Camera]:
    """The inverse; ends at the first entry that is missing or was not written by styl3r."""
    cameras: list[Camera] = []
    while camera := _parse(metadata.get(KEY.format(len(cameras)), "")):
        cameras.append(camera)
    return cameras


def damage(metadata: Mapping[str, str]) -> list[str]:
    """A note on cameras that `cameras_from_metadata` leaves out: wrong ones, and any after them."""
    read = len(cameras_from_metadata(metadata))
    if sum(KEYS.fullmatch(key) is not None for key in metadata) == read:
        return []
    which = f" from {KEY.format(read)} on" if read else ""
    return [f"the scene's cameras{which} are damaged and ignored"]


def _parse(text: str) -> Camera | None:
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        return None
    if len(values) != NUMBERS or not all(math.isfinite(value) for value in values):
        return None
    size, (fx, fy, cx, cy) = frame_size(*values[:2]), values[2:6]
    extrinsics = np.eye(4)
    extrinsics[:3] = np.reshape(values[6:], (3, 4))
    if size is None or not is_rotation(extrinsics[:3, :3]):
        return None
    if not is_lens(fx, size[0]) or not is_lens(fy, size[1]):
        return None
    if not is_centre(cx, size[0]) or not is_centre(cy, size[1]):
        return None
    if np.abs(extrinsics[:3, 3]).max() > FARTHEST:
        return None
    return Camera(extrinsics, fx, fy, cx, cy, *size)
