"""Camera paths for videos: where the camera is in each frame."""

from __future__ import annotations

import math
from collections.abc import Sequence

from styl3r_cli.cameras import swings
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.course import Course, frames_along
from styl3r_cli.cameras.extent import Extent
from styl3r_cli.cameras.fit import without_edges
from styl3r_cli.cameras.overview import default_camera, downwards, middle_camera
from styl3r_cli.cameras.tour import tour
from styl3r_cli.errors import UsageError
from styl3r_cli.gaussians import Gaussians

# By name, with what --help says of them.
PATHS = {
    "wobble": "a small swing around the middle view",
    "interpolate": "through all views, in their order",
    "orbit": "around the scene's middle: as far as the views go, or a full circle",
    "spiral": "growing and shrinking rounds, in and out",
    "dolly": "straight ahead into the scene",
}


def make_path(
    name: str,
    cameras: Sequence[Camera],
    gaussians: Gaussians,
    frames: int,
    *,
    amplitude: float = 1.0,
    loop: bool = True,
    eased: bool | None = None,
    arc: float | None = None,
) -> list[Camera]:
    """The cameras of a video's frames.

    Orbits, spirals and dollies are as large as keeps the scene in the frame, and the camera out of
    the scene, by the Gaussians themselves. Where a movement would show the scene's edges, the
    frame is a little narrower than the view.

    Args:
        name: one of PATHS.
        cameras: the views' cameras; with none, a path around the scene's default camera.
        gaussians: the scene.
        frames: how many, at least 1.
        amplitude: how wide to swing, as a multiple of what suits the scene; for a path between
            cameras, how much of the way to go (above 1 counts as 1).
        loop: come back to the start, so that the frame after the last would be the first.
        eased: slow at the ends, or at constant speed; by default as suits the path.
        arc: of an orbit, radians; 2 pi is a full circle. By default as far as the views go.

    Raises:
        UsageError: for an unknown name, no frames, no amplitude, or too few cameras for the path.
    """
    if name not in PATHS:
        raise UsageError(f"there is no camera path '{name}'; choose from {', '.join(PATHS)}")
    if frames < 1:
        raise UsageError(f"a path of {frames} frames is empty; ask for at least 1")
    if not (math.isfinite(amplitude) and amplitude > 0):
        raise UsageError(f"a path's amplitude of {amplitude} goes nowhere; give one above 0")
    return frames_along(_course(name, cameras, gaussians, amplitude, arc), frames, loop, eased)


def _course(
    name: str,
    cameras: Sequence[Camera],
    gaussians: Gaussians,
    amplitude: float,
    arc: float | None,
) -> Course:
    extent = Extent.of(gaussians)
    if name == "interpolate":
        if len(cameras) < 2:
            raise UsageError(
                f"the path 'interpolate' runs between cameras, and there {_count(len(cameras))}; "
                "give a camera file with 2 or more, or choose the path 'wobble'"
            )
        return tour(cameras, extent.depths(cameras[0])[1], amplitude)
    stage = _stage(cameras, gaussians, extent)
    if name == "dolly":
        return swings.dolly(stage, amplitude)
    if name == "orbit":
        if (arc is None and stage.surrounded) or (arc is not None and arc >= swings.FULL_CIRCLE):
            return swings.circle(stage)
        course = swings.orbit(stage, amplitude, arc)
    else:
        course = {"wobble": swings.wobble, "spiral": swings.spiral}[name](stage, amplitude)
    return without_edges(course, stage.camera, extent)


def _stage(cameras: Sequence[Camera], gaussians: Gaussians, extent: Extent) -> swings.Stage:
    if not cameras:
        camera = default_camera(gaussians)
        # A camera that had to step back looks at an object; one at the origin took the scene.
        stepped_back = bool(camera.extrinsics[:3, 3].any())
        return swings.Stage(camera, [camera], extent, camera.extrinsics[1, :3], stepped_back)
    camera, down = middle_camera(cameras), downwards(cameras)
    return swings.Stage(
        camera, cameras, extent, down, swings.surrounds(cameras, extent, camera, down)
    )


def _count(cameras: int) -> str:
    return "are none" if cameras == 0 else "is only one"
