"""Camera paths for videos: where the camera is in each frame. All of them loop seamlessly."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras import poses
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.errors import UsageError
from styl3r_cli.gaussians import Gaussians

Array = NDArray[np.float64]

# A wobble moves the scene's nearest and farthest parts, against its middle, by this fraction of
# the frame's width: parallax that is plain to see, while what no photo saw stays a thin seam.
WOBBLE_SHIFT = 0.04

# Nearest and farthest mean all but a few percent, which are often floaters or sky.
NEAREST_PERCENTILE, FARTHEST_PERCENTILE = 5, 95

# A scene with no depth (a painting, a wall) would call for any radius; relative to its distance:
LARGEST_RADIUS = 0.1

# Up and down less than left and right: landscapes have more to hide above and below.
WOBBLE_FLATTENING = 0.5

# The frame and field of view of a scene that came without cameras.
DEFAULT_SIZE = 512
SMALLEST_FOV, LARGEST_FOV = math.radians(25), math.radians(90)

PathMaker = Callable[[Sequence[Camera], Gaussians, int, float], list[Camera]]


def make_path(
    name: str,
    cameras: Sequence[Camera],
    gaussians: Gaussians,
    frames: int,
    *,
    amplitude: float = 1.0,
) -> list[Camera]:
    """The cameras of a video's frames, one loop of the path.

    Args:
        name: one of PATHS.
        cameras: the views' cameras; with none, a path around the scene's default camera.
        gaussians: the scene, whose depth sets how far the camera may go.
        frames: how many, at least 1; the frame after the last would be the first.
        amplitude: how wide to swing, as a multiple of what suits the scene; for a path between
            cameras, how much of the way to go (above 1 counts as 1).

    Raises:
        UsageError: for an unknown name, no frames, no amplitude, or too few cameras for the path.
    """
    if name not in PATHS:
        raise UsageError(f"there is no camera path '{name}'; choose from {', '.join(PATHS)}")
    if frames < 1:
        raise UsageError(f"a path of {frames} frames is empty; ask for at least 1")
    if not (math.isfinite(amplitude) and amplitude > 0):
        raise UsageError(f"a path's amplitude of {amplitude} goes nowhere; give one above 0")
    return PATHS[name](cameras, gaussians, frames, amplitude)


def default_camera(
    gaussians: Gaussians, width: int = DEFAULT_SIZE, height: int = DEFAULT_SIZE
) -> Camera:
    """A camera for a scene that came without: the world's origin, looking along +z.

    That is the first view in the scenes made here; the field of view takes in most of what lies
    in front. In a foreign scene that lies elsewhere, the camera steps back until it sees it.
    """
    means = gaussians.means[np.isfinite(gaussians.means).all(axis=1)].astype(np.float64)
    extrinsics = np.eye(4)
    if len(means) and np.median(means[:, 2]) <= 0:
        middle = np.median(means, axis=0)
        radius = np.percentile(np.linalg.norm(means - middle, axis=1), FARTHEST_PERCENTILE)
        extrinsics[:3, 3] = [0, 0, 2 * radius] - middle
    in_view = means @ extrinsics[:3, :3].T + extrinsics[:3, 3]
    in_view = in_view[in_view[:, 2] > 0]
    slope = math.tan(SMALLEST_FOV / 2)
    if len(in_view):
        sides = np.abs(in_view[:, :2] / in_view[:, 2:] / [width, height]).max(axis=1)
        slope = max(slope, max(width, height) * float(np.percentile(sides, FARTHEST_PERCENTILE)))
    focal = max(width, height) / 2 / min(slope, math.tan(LARGEST_FOV / 2))
    return Camera(extrinsics, focal, focal, width / 2, height / 2, width, height)


def _wobble(
    cameras: Sequence[Camera], gaussians: Gaussians, frames: int, amplitude: float
) -> list[Camera]:
    """A small ellipse around the middle view, always looking at the scene's median depth."""
    camera = _middle(cameras) if cameras else default_camera(gaussians)
    nearest, middle, farthest = _depths(camera, gaussians)
    spread = max(1 / nearest - 1 / middle, 1 / middle - 1 / farthest)
    # Moving sideways by r shifts depth z against the middle by fx r |1/z - 1/middle| pixels.
    radius = LARGEST_RADIUS * middle
    if spread > 0:
        radius = min(radius, WOBBLE_SHIFT * camera.width / camera.fx / spread)
    path = []
    for angle in 2 * np.pi * np.arange(frames) / frames:
        offset = np.array([np.cos(angle), WOBBLE_FLATTENING * np.sin(angle), 0])
        eye = amplitude * radius * offset
        turned = _look_at(eye, np.array([0, 0, middle])) @ camera.extrinsics
        path.append(replace(camera, extrinsics=turned))
    return path


def _middle(cameras: Sequence[Camera]) -> Camera:
    """The camera nearest to the middle of all of them; the first of equals."""
    centres = np.array([poses.centre(camera.extrinsics) for camera in cameras])
    distances = np.linalg.norm(centres - centres.mean(axis=0), axis=1)
    return cameras[int(np.argmax(distances <= distances.min() * (1 + 1e-6)))]


def _depths(camera: Camera, gaussians: Gaussians) -> tuple[float, float, float]:
    """Nearest, median and farthest depth of the Gaussians whose means a camera sees."""
    means = gaussians.means.astype(np.float64)
    with np.errstate(all="ignore"):
        in_view = means @ camera.extrinsics[:3, :3].T + camera.extrinsics[:3, 3]
        x = camera.fx * in_view[:, 0] / in_view[:, 2] + camera.cx
        y = camera.fy * in_view[:, 1] / in_view[:, 2] + camera.cy
        ahead = (in_view[:, 2] > 0) & np.isfinite(in_view).all(axis=1)
        seen = ahead & (abs(x - camera.width / 2) < camera.width / 2)
        seen &= abs(y - camera.height / 2) < camera.height / 2
    depths = in_view[seen if seen.any() else ahead, 2]
    if len(depths) == 0:
        return 1.0, 1.0, 1.0
    nearest, middle, farthest = np.percentile(depths, [NEAREST_PERCENTILE, 50, FARTHEST_PERCENTILE])
    return float(nearest), float(middle), float(farthest)


def _look_at(eye: Array, target: Array) -> Array:
    """(4, 4) extrinsics of a camera at ``eye`` that faces ``target``, its y near the world's."""
    forward = target - eye
    forward /= np.linalg.norm(forward)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    extrinsics = np.eye(4)
    extrinsics[:3, :3] = [right, np.cross(forward, right), forward]
    extrinsics[:3, 3] = -extrinsics[:3, :3] @ eye
    return extrinsics


def _interpolate(
    cameras: Sequence[Camera], gaussians: Gaussians, frames: int, amplitude: float
) -> list[Camera]:
    """Through the views' cameras in order and back, slow at both ends."""
    if len(cameras) < 2:
        raise UsageError(
            f"the path 'interpolate' runs between cameras, and there {_count(len(cameras))}; "
            "give a camera file with 2 or more, or choose the path 'wobble'"
        )
    first = cameras[0]
    stops = [poses.from_camera(camera.resized(first.width, first.height)) for camera in cameras]
    last = len(stops) - 1
    path = []
    for turn in np.arange(frames) / frames:
        eased = 0.5 - 0.5 * math.cos(2 * math.pi * turn)
        time = last * eased * min(amplitude, 1.0)
        segment = min(int(time), last - 1)
        around = [stops[min(max(segment + k, 0), last)] for k in (-1, 0, 1, 2)]
        path.append(poses.to_camera(poses.catmull_rom(around, time - segment), first))
    return path


def _count(cameras: int) -> str:
    return "are none" if cameras == 0 else "is only one"


PATHS: dict[str, PathMaker] = {"wobble": _wobble, "interpolate": _interpolate}
