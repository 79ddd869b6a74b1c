"""Numbers and matrices out of other programs' JSON, checked."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.errors import InputError
from styl3r_cli.files import read_file
from styl3r_cli.incoming import Kind

# Files with six digits are off by 1e-6; a scaled or sheared matrix by far more.
RIGID_TOLERANCE = 1e-3
LARGEST_SIDE = 99_999  # pixels of a frame; `--size` takes as many digits
FARTHEST = 1e15  # of a camera from the origin: float32 holds squares up to 3e38
# Degrees across or down a frame: what the renderer is exact for, and more than any lens has.
NARROWEST, WIDEST = 0.01, 179.0
# Frames between a frame and its principal point. A crop of a large photo has it outside: 100 frames
# away is a frame of 200 pixels out of the corner of one of 40,000.
FARTHEST_CENTRE = 100
MOST_FPS = 1000  # as many as `--fps` takes
# Bytes of a camera file: `render --save-path` writes 130 MB for as many frames as it draws at most.
CAMERA_FILE = Kind("a camera file", 256 << 20)
LONGEST_QUOTE = 40  # characters of a wrong value in a message


def load_object(source: Path | bytes) -> tuple[str, dict[str, Any]]:
    """The name of a source, for messages, and the JSON object in it."""
    name = "-" if isinstance(source, bytes) else str(source)
    try:
        data = source if isinstance(source, bytes) else read_file(source, CAMERA_FILE)
        content = json.loads(data)
    except OSError as error:
        raise InputError(f"{name}: cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name}: not a JSON file: {error}") from error
    if not isinstance(content, dict):
        raise InputError(f"{name}: expected nerfstudio's transforms.json, an object with 'frames'")
    return name, content


def number(values: dict[str, Any], key: str, where: str) -> float | None:
    """A finite number, or None if the key is missing."""
    value = values.get(key)
    if value is None:
        return None
    try:
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
    except OverflowError:  # JSON's whole numbers have any number of digits
        pass
    raise InputError(f"{where}: '{key}' is {shown(value)}, not a number")


def rate(values: dict[str, Any], where: str) -> float | None:
    """Frames per second, or None if the file does not say."""
    fps = number(values, "fps", where)
    if fps is not None and fps > MOST_FPS:
        raise InputError(f"{where}: 'fps' is {fps:g}; at most {MOST_FPS} frames a second")
    return fps


def frame_size(width: float | None, height: float | None) -> tuple[int, int] | None:
    """Whole pixels, or None if no frame has such sides."""
    sides = [side for side in (width, height) if side is not None and 1 <= side <= LARGEST_SIDE]
    if len(sides) < 2 or any(side % 1 for side in sides):
        return None
    return int(sides[0]), int(sides[1])


def is_lens(focal: float, side: float) -> bool:
    """Whether a focal length in pixels gives a frame's side an angle that can be drawn."""
    if not focal > 0:
        return False
    return NARROWEST <= math.degrees(2 * math.atan(side / 2 / focal)) <= WIDEST


def is_centre(coordinate: float, side: float) -> bool:
    """Whether a principal point's coordinate in pixels is one of a frame so wide or high."""
    return -FARTHEST_CENTRE * side <= coordinate <= (1 + FARTHEST_CENTRE) * side


def rigid(matrix: Any, where: str, key: str = "transform_matrix") -> NDArray[np.float64]:
    """A 4x4 (or 3x4) camera-to-world matrix with an exact rotation."""
    try:
        rows = np.array(matrix if _has_numbers(matrix) else (), dtype=np.float64)
    except (ValueError, OverflowError):
        rows = np.empty(0)
    if rows.shape not in ((4, 4), (3, 4)) or not np.isfinite(rows).all():
        raise InputError(f"{where}: '{key}' is not a 4x4 matrix of numbers")
    if len(rows) == 4 and not np.allclose(rows[3], [0, 0, 0, 1], atol=RIGID_TOLERANCE):
        raise InputError(f"{where}: the last row of '{key}' is not 0 0 0 1")
    rotation = rows[:3, :3]
    if not is_rotation(rotation, or_mirror=True):
        raise InputError(f"{where}: '{key}' is no rigid motion (scaled or sheared)")
    if np.linalg.det(rotation) < 0:
        raise InputError(f"{where}: '{key}' mirrors the scene")
    if np.abs(rows[:3, 3]).max() > FARTHEST:
        raise InputError(f"{where}: '{key}' is too far out to be drawn")
    left, _, right = np.linalg.svd(rotation)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = left @ right, rows[:3, 3]
    return pose


def _has_numbers(matrix: Any) -> bool:
    """Whether it is rows of JSON's numbers: numpy takes texts and truth values for some, too."""
    return isinstance(matrix, list) and all(
        isinstance(row, list)
        and all(isinstance(each, int | float) and not isinstance(each, bool) for each in row)
        for row in matrix
    )


def is_rotation(matrix: NDArray[np.float64], or_mirror: bool = False) -> bool:
    """Whether a (3, 3) matrix turns and nothing else; other programs round to few digits."""
    if not (np.abs(matrix) < 2).all():  # also what is not a number, and what would overflow
        return False
    error = np.abs(matrix.T @ matrix - np.eye(3)).max()
    return bool(error <= RIGID_TOLERANCE) and (or_mirror or bool(np.linalg.det(matrix) > 0))


def shown(value: object) -> str:
    """A value for a message: JSON's can be as long as the file."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # thousands of digits, or of brackets
        return "something"
    return text if len(text) <= LONGEST_QUOTE else f"{text[:LONGEST_QUOTE]}..."
