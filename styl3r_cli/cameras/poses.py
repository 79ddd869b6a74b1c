"""Poses that can be blended: smooth curves through cameras."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera

Array = NDArray[np.float64]

# Below this angle (radians) slerp divides by nearly nothing, and a straight line is exact.
SMALL_ANGLE = 1e-6

# A pose is a unit quaternion w x y z, the camera's centre, and its lens fx fy cx cy: 11 numbers.


def catmull_rom(poses: Sequence[Array], times: Array, t: float) -> Array:
    """A smooth curve through four poses at four rising times; ``t`` lies between the middle two.

    Barry and Goldman's pyramid (SIGGRAPH 1988), which needs nothing but blends of two: it works
    on rotations as it does on points.
    """
    level = list(poses)
    for span in (1, 2):
        level = [
            blend(level[i], level[i + 1], (t - times[i]) / (times[i + span] - times[i]))
            for i in range(len(level) - 1)
        ]
    return blend(level[0], level[1], (t - times[1]) / (times[2] - times[1]))


def blend(a: Array, b: Array, t: float) -> Array:
    """From pose ``a`` at 0 to ``b`` at 1: slerp of the rotation, the rest in a straight line."""
    line = (1 - t) * a + t * b
    cosine = float(a[:4] @ b[:4])
    end = b[:4] if cosine >= 0 else -b[:4]  # q and -q are one rotation: take the short way
    angle = math.acos(min(abs(cosine), 1.0))
    if angle > SMALL_ANGLE:
        line[:4] = (math.sin((1 - t) * angle) * a[:4] + math.sin(t * angle) * end) / math.sin(angle)
    else:
        line[:4] = (1 - t) * a[:4] + t * end
    line[:4] /= np.linalg.norm(line[:4])
    return line


def centre(extrinsics: Array) -> Array:
    """(3,) where a camera stands in the world."""
    return -extrinsics[:3, :3].T @ extrinsics[:3, 3]


def from_camera(camera: Camera) -> Array:
    """A camera's pose: quaternion, centre, lens (11,)."""
    lens = [camera.fx, camera.fy, camera.cx, camera.cy]
    turn = to_quaternion(camera.extrinsics[:3, :3].T)
    return np.concatenate([turn, centre(camera.extrinsics), lens])


def to_camera(pose: Array, like: Camera) -> Camera:
    """The camera of a pose, with the frame size of another camera."""
    extrinsics = np.eye(4)
    extrinsics[:3, :3] = _to_matrix(pose[:4]).T
    extrinsics[:3, 3] = -extrinsics[:3, :3] @ pose[4:7]
    fx, fy, cx, cy = (float(value) for value in pose[7:])
    return replace(like, extrinsics=extrinsics, fx=fx, fy=fy, cx=cx, cy=cy)


def _to_matrix(quaternion: Array) -> Array:
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def to_quaternion(m: Array) -> Array:
    """The unit quaternion nearest to a rotation matrix (Bar-Itzhack 2000): stable everywhere."""
    k = np.zeros((4, 4))
    k[0] = [m.trace(), m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]]
    k[1:, 0] = k[0, 1:]
    k[1:, 1:] = m + m.T - m.trace() * np.eye(3)
    return np.linalg.eigh(k)[1][:, -1]


def to_quaternions(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """(G, 4) unit quaternions w x y z of (G, 3, 3) rotation matrices.

    The four candidates of Shepperd (1978) are the columns of one symmetric matrix, 4 q q^T; the
    longest of them is the most precise.
    """
    m = matrices
    trace = np.trace(m, axis1=1, axis2=2)
    squares = np.empty((len(m), 4, 4))
    squares[:, 0, 0] = 1 + trace
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        squares[:, i + 1, i + 1] = 1 - trace + 2 * m[:, i, i]
        squares[:, 0, i + 1] = squares[:, i + 1, 0] = m[:, k, j] - m[:, j, k]
        squares[:, j + 1, k + 1] = squares[:, k + 1, j + 1] = m[:, j, k] + m[:, k, j]
    best = np.einsum("gii->gi", squares).argmax(axis=1)
    columns = squares[np.arange(len(m)), best]
    return columns / np.linalg.norm(columns, axis=1, keepdims=True)
