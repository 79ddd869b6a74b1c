"""Where the camera of every frame of `render` comes from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.framing import cropped, with_fov
from styl3r_cli.cameras.paths import PATHS, make_path
from styl3r_cli.cameras.stored import cameras_from_metadata
from styl3r_cli.cameras.transforms import CameraFile
from styl3r_cli.commands.options import LOOP_FPS, LOOP_FRAMES
from styl3r_cli.commands.render_request import RenderRequest
from styl3r_cli.console import Console
from styl3r_cli.errors import UsageError
from styl3r_cli.formats import Scene
from styl3r_cli.frames import enlarged
from styl3r_cli.names import user_path

LEAST_SIDE = 512  # stored cameras have the network's few pixels; Gaussians are smooth between them


@dataclass(frozen=True)
class Shots:
    """The camera of every frame, and how fast they follow each other.

    Attributes:
        cameras: one per frame, all of one size.
        fps: frames per second.
        loop: whether the last frame leads to the first.
    """

    cameras: list[Camera]
    fps: float
    loop: bool


def plan_shots(request: RenderRequest, scene: Scene, console: Console) -> Shots:
    """The frames' cameras: of a file as they are, or along a path.

    Raises:
        InputError: a camera file is unusable.
        UsageError: there is no such path, or not enough cameras for it.
    """
    path_file = _file_of_path(request.path)
    source = path_file or request.cameras
    file = _read(source, request, console) if source else None
    fps = request.fps or (file.fps if file else None) or LOOP_FPS
    if file is not None:
        views = file.cameras
    else:
        stored = cameras_from_metadata(scene.metadata)
        views = [enlarged(camera, LEAST_SIDE) for camera in stored]
    as_they_are = request.path is None or (path_file is not None and request.frames is None)
    if as_they_are:
        cameras = [_like(camera, views[0], request) for camera in views]
        if request.size is None and any(_is_other(camera, views[0]) for camera in views):
            size = f"{views[0].width}x{views[0].height}"
            console.note(
                f"{source or request.scene}: cameras of another shape are cropped to {size}"
            )
        return Shots(_framed(cameras, request), fps, bool(file and file.loop))
    cameras = make_path(
        "interpolate" if path_file else str(request.path),
        views,
        scene.gaussians,
        request.frames or LOOP_FRAMES,
        amplitude=request.amplitude,
        loop=request.loop,
        eased=request.eased,
        arc=None if request.arc is None else math.radians(request.arc),
    )
    return Shots(_framed(cameras, request), fps, request.loop)


def _file_of_path(path: str | None) -> Path | None:
    """The file that --path names instead of a movement."""
    if path is None or path in PATHS:
        return None
    file = user_path(path)
    if not file.suffix and not file.exists():
        known = ", ".join(PATHS)
        raise UsageError(f"--path {path}: there is no such path; use {known}, or a camera file")
    return file


def _read(path: Path, request: RenderRequest, console: Console) -> CameraFile:
    from styl3r_cli.cameras.camera_path import read_cameras

    file = read_cameras(path, request.size)
    for note in file.notes:
        console.note(note)
    return file


def _is_other(camera: Camera, first: Camera) -> bool:
    """Whether its frames are of another shape, by more than a pixel of the first one's."""
    difference = abs(camera.width * first.height - camera.height * first.width)
    return difference > max(first.width, first.height)


def _like(camera: Camera, first: Camera, request: RenderRequest) -> Camera:
    """The camera with frames of the first one's size, if no other was asked for."""
    if request.size is not None:
        return camera
    if _is_other(camera, first):
        return cropped(camera, first.width, first.height)
    return camera.resized(first.width, first.height)


def _framed(cameras: list[Camera], request: RenderRequest) -> list[Camera]:
    """The cameras with the frame size and the lens that were asked for."""
    if request.size is not None:
        cameras = [cropped(camera, *request.size) for camera in cameras]
    if request.fov is not None:
        cameras = [with_fov(camera, request.fov) for camera in cameras]
    return cameras
