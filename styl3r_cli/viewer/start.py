"""Where the viewer starts, and what it turns around."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras import poses
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.extent import Extent
from styl3r_cli.cameras.overview import default_camera, downwards
from styl3r_cli.gaussians import Gaussians

Array = NDArray[np.float64]

# A camera that looks nearly along the scene's vertical has an up direction of its own: there the
# scene's says next to nothing about how the picture is turned.
STEEP = math.cos(math.radians(15))


@dataclass(frozen=True)
class View:
    """A camera as one that turns around a point.

    Attributes:
        position: (3,) where it stands, in scene units.
        look_at: (3,) the point in the middle of its picture that it turns around.
        up: (3,) unit vector; upright in the picture.
        fov: vertical field of view, radians.
        depth: from `position` to `look_at`, in scene units.
    """

    position: Array
    look_at: Array
    up: Array
    fov: float
    depth: float


def first_view(gaussians: Gaussians, cameras: Sequence[Camera]) -> View:
    """The first input camera's view; without cameras, one that takes in the scene."""
    camera = cameras[0] if cameras else default_camera(gaussians)
    up = -downwards(cameras) if cameras else -camera.extrinsics[1, :3]
    return view_of(camera, gaussians, up)


def view_of(camera: Camera, gaussians: Gaussians, up: Array) -> View:
    """A camera's view, turning around what is in its middle.

    Args:
        camera: its picture is kept as it is, but with the principal point in the middle.
        gaussians: the scene, for the distance to its middle.
        up: (3,) the scene's up direction, which is followed as far as the picture allows.
    """
    right, down, forward = camera.extrinsics[:3, :3]
    upright = up - (up @ right) * right  # any direction in this plane gives the same picture
    length = float(np.linalg.norm(upright))
    if length == 0 or abs(upright @ forward) > STEEP * length or upright @ down > 0:
        upright, length = -down, 1.0
    position = poses.centre(camera.extrinsics)
    depth = Extent.of(gaussians).depths(camera)[1]
    return View(
        position=position,
        look_at=position + depth * forward,
        up=upright / length,
        fov=vertical_fov(camera),
        depth=depth,
    )


def vertical_fov(camera: Camera) -> float:
    """The frame's height as an angle, in radians."""
    return 2 * math.atan(camera.height / 2 / camera.fy)
