"""Numbers and matrices out of other programs' JSON, checked."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.errors import InputError

# Files with six digits are off by 1e-6; a scaled or sheared matrix by far more.
RIGID_TOLERANCE = 1e-3


def load_object(source: Path | bytes) -> tuple[str, dict[str, Any]]:
    """The name of a source, for messages, and the JSON object in it."""
    name = "-" if isinstance(source, bytes) else str(source)
    try:
        data = source if isinstance(source, bytes) else source.read_bytes()
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
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{where}: '{key}' is {value!r}, not a number")
    return float(value)


def rigid(matrix: Any, where: str, key: str = "transform_matrix") -> NDArray[np.float64]:
    """A 4x4 (or 3x4) camera-to-world matrix with an exact rotation."""
    try:
        rows = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError):
        rows = np.empty(0)
    if rows.shape not in ((4, 4), (3, 4)) or not np.isfinite(rows).all():
        raise InputError(f"{where}: '{key}' is not a 4x4 matrix of numbers")
    if len(rows) == 4 and not np.allclose(rows[3], [0, 0, 0, 1], atol=RIGID_TOLERANCE):
        raise InputError(f"{where}: the last row of '{key}' is not 0 0 0 1")
    rotation = rows[:3, :3]
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > RIGID_TOLERANCE:
        raise InputError(f"{where}: '{key}' is no rigid motion (scaled or sheared)")
    if np.linalg.det(rotation) < 0:
        raise InputError(f"{where}: '{key}' mirrors the scene")
    left, _, right = np.linalg.svd(rotation)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = left @ right, rows[:3, 3]
    return pose
