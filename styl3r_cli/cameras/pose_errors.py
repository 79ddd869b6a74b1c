"""How far one camera's motion is from another's, in degrees: no unit of length is needed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# The direction of a motion of length 0: what a direction drawn at random is off by on average.
NO_DIRECTION = 90.0

Array = NDArray[np.float64]


def motion(a: Array, b: Array) -> Array:
    """(4, 4): from the frame of a camera with extrinsics a to that of one with b."""
    return b @ np.linalg.inv(a)


def rotation_error(guess: Array, truth: Array) -> float:
    """Degrees between two rotations, exact for small angles too."""
    difference = guess[:3, :3].T @ truth[:3, :3]
    chord = np.linalg.norm(difference - np.eye(3)) / np.sqrt(8)
    return float(np.degrees(2 * np.arcsin(min(chord, 1.0))))


def direction_error(guess: Array, truth: Array) -> float:
    """Degrees between two translations; NO_DIRECTION if one of them is 0."""
    a, b = guess[:3, 3], truth[:3, 3]
    lengths = np.linalg.norm(a) * np.linalg.norm(b)
    if lengths == 0:
        return NO_DIRECTION
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))
