"""Camera movements around what the views show: wobble, orbit, spiral and dolly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras import poses
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.course import Course
from styl3r_cli.cameras.extent import Extent
from styl3r_cli.cameras.fit import largest_reach

Array = NDArray[np.float64]

# A wobble moves the scene's nearest and farthest parts, against its middle, by this fraction of
# the frame's width: parallax that is plain to see, while what no photo saw stays a thin seam.
WOBBLE_SHIFT = 0.04
# A scene with no depth (a painting, a wall) would call for any radius; relative to its distance:
LARGEST_RADIUS = 0.1
# Up and down less than left and right: landscapes have more to hide above and below.
FLATTENING = 0.5
# A spiral swings twice as far as a wobble, its rounds growing and shrinking, and breathes in depth
# by this share of the distance to what is nearest.
SPIRAL_REACH, SPIRAL_ROUNDS, SPIRAL_BREATH = 2.0, 2, 0.15
# A dolly goes in by this share of the way to the scene's middle.
DOLLY_REACH = 0.35
# Between two photos of the front of something an orbit shows at least this arc, and views this far
# around it mean that there are photos from all sides.
LEAST_ARC, ALL_AROUND = math.radians(30), math.radians(240)
FULL_CIRCLE = 2 * math.pi
# Room around the scene's bounds in a full circle.
CIRCLE_MARGIN = 1.1


@dataclass(frozen=True)
class Stage:
    """What a movement is made around.

    Attributes:
        camera: the view to start from.
        cameras: all views; at least that one.
        extent: the scene.
        down: (3,) unit vector, world frame.
        surrounded: whether the scene is to be seen from all sides.
    """

    camera: Camera
    cameras: Sequence[Camera]
    extent: Extent
    down: Array
    surrounded: bool

    @property
    def target(self) -> Array:
        """(3,) the middle of what the camera sees, straight ahead, world frame."""
        depth = self.extent.depths(self.camera)[1]
        return poses.centre(self.camera.extrinsics) + depth * self.camera.extrinsics[2, :3]


def wobble(stage: Stage, amplitude: float) -> Course:
    """A small ellipse around the view, always looking at the scene's median depth."""
    camera, middle = stage.camera, stage.extent.depths(stage.camera)[1]
    radius = amplitude * parallax_radius(stage)

    def at(place: float) -> Camera:
        angle = 2 * np.pi * place
        eye = radius * np.array([np.cos(angle), FLATTENING * np.sin(angle), 0])
        return _moved(camera, eye, middle)

    return Course(at, closed=True, eased=False)


def spiral(stage: Stage, amplitude: float) -> Course:
    """Rounds that grow out of the view and shrink back into it, going in and coming out again."""
    camera = stage.camera
    nearest, middle, _ = stage.extent.depths(camera)
    across = max(SPIRAL_REACH * parallax_radius(stage), _spread(stage) / 2)

    def sized(reach: float) -> Course:
        def at(place: float) -> Camera:
            angle = 2 * np.pi * SPIRAL_ROUNDS * place
            grown = reach * np.sin(np.pi * place) ** 2
            side = grown * across
            breath = grown * SPIRAL_BREATH * nearest
            eye = [side * np.cos(angle), FLATTENING * side * np.sin(angle), breath]
            return _moved(camera, np.array(eye), middle)

        return Course(at, closed=True, eased=False)

    return sized(amplitude * largest_reach(sized, stage.camera, stage.extent))


def dolly(stage: Stage, amplitude: float) -> Course:
    """Straight ahead into the scene."""
    camera = stage.camera
    travel = DOLLY_REACH * stage.extent.depths(camera)[1]

    def sized(reach: float) -> Course:
        def at(place: float) -> Camera:
            step = np.eye(4)
            step[2, 3] = -reach * travel * place
            return replace(camera, extrinsics=step @ camera.extrinsics)

        return Course(at, closed=False, eased=True)

    return sized(amplitude * largest_reach(sized, stage.camera, stage.extent))


def orbit(stage: Stage, amplitude: float, arc: float | None = None) -> Course:
    """Around the scene's middle at one height, as far as the views go.

    Args:
        stage: what to go around.
        amplitude: of the arc, if it is not given.
        arc: how far, radians, whatever that shows.
    """
    target = stage.target
    angles = _azimuths(stage, target)
    middle = (max(angles) + min(angles)) / 2
    half = max(max(angles) - min(angles), LEAST_ARC) / 2 if arc is None else arc / 2

    def sized(reach: float) -> Course:
        def at(place: float) -> Camera:
            return _around(
                stage.camera, target, stage.down, middle + reach * half * (2 * place - 1)
            )

        return Course(at, closed=False, eased=True, start=0.25)

    if arc is not None:
        return sized(1.0)
    return sized(min(amplitude * largest_reach(sized, stage.camera, stage.extent), math.pi / half))


def circle(stage: Stage) -> Course:
    """All around the scene's bounds, from far enough to have them in the frame."""
    low, high = stage.extent.bounds()
    centre, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    camera = stage.camera
    slope = min(camera.width / camera.fx, camera.height / camera.fy) / 2
    distance = CIRCLE_MARGIN * radius / math.sin(math.atan(slope))
    ahead = camera.extrinsics[2, :3]
    facing = camera.extrinsics.copy()
    facing[:3, 3] = -facing[:3, :3] @ (centre - distance * ahead)
    start = replace(camera, extrinsics=facing, cx=camera.width / 2, cy=camera.height / 2)

    def at(place: float) -> Camera:
        return _around(start, centre, stage.down, FULL_CIRCLE * place)

    return Course(at, closed=True, eased=False)


def parallax_radius(stage: Stage) -> float:
    """How far to the side the camera goes for a plain, but small, parallax; scene units."""
    camera = stage.camera
    nearest, middle, farthest = stage.extent.depths(camera)
    spread = max(1 / nearest - 1 / middle, 1 / middle - 1 / farthest)
    # Moving sideways by r shifts depth z against the middle by fx r |1/z - 1/middle| pixels.
    if spread <= 0:
        return LARGEST_RADIUS * middle
    return min(LARGEST_RADIUS * middle, WOBBLE_SHIFT * camera.width / camera.fx / spread)


def _spread(stage: Stage) -> float:
    """How far apart the views are, sideways as the camera sees it."""
    centres = np.array([poses.centre(camera.extrinsics) for camera in stage.cameras])
    return float(np.ptp(centres @ stage.camera.extrinsics[0, :3]))


def _azimuths(stage: Stage, target: Array) -> list[float]:
    """Angles of the views around the vertical through the target, from the camera's, radians."""
    reference = poses.centre(stage.camera.extrinsics) - target
    reference -= stage.down * (reference @ stage.down)
    side = np.cross(stage.down, reference)
    angles = []
    for camera in stage.cameras:
        arm = poses.centre(camera.extrinsics) - target
        angles.append(math.atan2(float(arm @ side), float(arm @ reference)))
    return angles


def surrounds(cameras: Sequence[Camera], extent: Extent, camera: Camera, down: Array) -> bool:
    """Whether views were taken from all sides: no large gap between their angles."""
    stage = Stage(camera, cameras, extent, down, surrounded=False)
    angles = np.sort(_azimuths(stage, stage.target))
    gaps = np.diff(np.append(angles, angles[0] + FULL_CIRCLE))
    return bool(FULL_CIRCLE - gaps.max() >= ALL_AROUND)


def _around(camera: Camera, target: Array, axis: Array, angle: float) -> Camera:
    """The camera turned about an axis through the target (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    back = np.eye(4)  # of the world, the other way: the camera stays and the world turns
    back[:3, :3] = turn.T
    back[:3, 3] = target - turn.T @ target
    return replace(camera, extrinsics=camera.extrinsics @ back)


def _moved(camera: Camera, eye: Array, depth: float) -> Camera:
    """The camera at another place in its own frame, facing the point straight ahead at a depth."""
    forward = np.array([0, 0, depth]) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    turn = np.eye(4)
    turn[:3, :3] = [right, np.cross(forward, right), forward]
    turn[:3, 3] = -turn[:3, :3] @ eye
    return replace(camera, extrinsics=turn @ camera.extrinsics)
