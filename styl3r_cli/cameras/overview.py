"""Reference cameras of a scene: the one to start from, and which way is up."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras import poses
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.extent import FARTHEST, HIGH, LOW, Extent, quantiles
from styl3r_cli.gaussians import Gaussians

Array = NDArray[np.float64]

# The frame and field of view of a scene that came without cameras.
DEFAULT_SIZE = 512
SMALLEST_FOV, LARGEST_FOV = math.radians(25), math.radians(90)
# Of a scene made here, the first view sees what its own photo shows: one of at most 8.
LEAST_SEEN = 1 / 8
# What is a smaller part of the frame's longer side was not photographed from there: a lens of 250
# mm fills a third of the narrowest frame.
SMALLEST_SHOWN = 1 / 4
# Photos are taken level to about 6 degrees (0.1): so far their x axes are trusted.
LEVEL = 0.1


def default_camera(
    gaussians: Gaussians, width: int = DEFAULT_SIZE, height: int = DEFAULT_SIZE
) -> Camera:
    """A camera for a scene that came without: the world's origin, looking along +z.

    That is the first view in the scenes made here; the field of view takes in most of what lies
    in front. In a foreign scene that lies elsewhere, behind, beside or far beyond what that sees,
    the camera goes to where it sees it.
    """
    extent = Extent.of(gaussians)
    camera = _framed(np.eye(4), extent, width, height)
    if len(extent.means) and not _shows(camera, extent):
        means, weights = extent.means, extent.weights
        middle = np.array([quantiles(axis, weights, (0.5,))[0] for axis in means.T])
        distances = np.linalg.norm(means - middle, axis=1)
        radius = quantiles(distances, weights, (FARTHEST,))[0]
        if radius > 0 or not extent.share_in(camera):
            extrinsics = np.eye(4)
            extrinsics[:3, 3] = [0, 0, 2 * radius] - middle
            camera = _framed(extrinsics, extent, width, height)
    return camera


def _shows(camera: Camera, extent: Extent) -> bool:
    """Whether a camera at the origin sees enough of a scene, and large enough."""
    ahead = quantiles(extent.means[:, 2], extent.weights, (0.5,))[0] > 0
    widest = _camera(camera.extrinsics, math.tan(LARGEST_FOV / 2), camera.width, camera.height)
    if not ahead or extent.share_in(widest) < LEAST_SEEN:
        return False
    slopes, weights = _slopes(camera.extrinsics, extent)
    low, high = np.array([quantiles(axis, weights, (LOW, HIGH)) for axis in slopes.T]).T
    across = max(camera.width, camera.height) / camera.fx
    return bool((high - low).max() >= SMALLEST_SHOWN * across)


def _framed(extrinsics: Array, extent: Extent, width: int, height: int) -> Camera:
    """A camera whose field of view takes in most of what lies in front of it."""
    slopes, weights = _slopes(extrinsics, extent)
    slope = math.tan(SMALLEST_FOV / 2)
    if len(slopes):
        sides = np.abs(slopes / [width, height]).max(axis=1)
        slope = max(slope, max(width, height) * quantiles(sides, weights, (FARTHEST,))[0])
    return _camera(extrinsics, min(slope, math.tan(LARGEST_FOV / 2)), width, height)


def _slopes(extrinsics: Array, extent: Extent) -> tuple[Array, Array]:
    """Where (P, 2) points before a camera are in its frame, a unit ahead, and their weights."""
    in_view = extent.means @ extrinsics[:3, :3].T + extrinsics[:3, 3]
    ahead = in_view[:, 2] > 0
    return in_view[ahead, :2] / in_view[ahead, 2:], extent.weights[ahead]


def _camera(extrinsics: Array, slope: float, width: int, height: int) -> Camera:
    """A camera whose longer side reaches so far to either side, per unit of depth."""
    focal = max(width, height) / 2 / slope
    return Camera(extrinsics, focal, focal, width / 2, height / 2, width, height)


def middle_camera(cameras: Sequence[Camera]) -> Camera:
    """The camera nearest to the middle of all of them; the first of equals."""
    centres = np.array([poses.centre(camera.extrinsics) for camera in cameras])
    distances = np.linalg.norm(centres - centres.mean(axis=0), axis=1)
    return cameras[int(np.argmax(distances <= distances.min() * (1 + 1e-6)))]


def downwards(cameras: Sequence[Camera]) -> Array:
    """(3,) unit vector, world frame: which way is down, as far as the cameras tell.

    Near their mean y axis, and as orthogonal as possible to their x axes, which people keep level
    also where they tilt the camera up or down (least squares with a prior).
    """
    rotations = np.array([camera.extrinsics[:3, :3] for camera in cameras])
    prior = rotations[:, 1].mean(axis=0)
    level = rotations[:, 0].T @ rotations[:, 0] / len(cameras)
    down = np.linalg.solve(level + LEVEL**2 * np.eye(3), prior)
    length = np.linalg.norm(down)
    return down / length if length > 0 else rotations[0, 1]
