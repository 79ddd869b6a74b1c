"""What `render` does: a scene and cameras in, a video or numbered pictures out."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.framing import cropped
from styl3r_cli.cameras.paths import make_path
from styl3r_cli.cameras.stored import cameras_from_metadata
from styl3r_cli.commands.checks import check_outputs, check_stdout
from styl3r_cli.commands.options import STDOUT
from styl3r_cli.console import Console
from styl3r_cli.errors import OutputError, UsageError
from styl3r_cli.files import read_stdin, write_stdout
from styl3r_cli.formats import Scene, read_scene
from styl3r_cli.frames import Colour, Picture, draw_path, enlarged, write_png

VIDEO_SUFFIX, PICTURE_SUFFIX = ".mp4", ".png"
LEAST_SIDE = 512  # stored cameras have the network's few pixels; Gaussians are smooth between them


@dataclass(frozen=True)
class RenderRequest:
    """The options of `render`. Without a path, every camera of the file is one frame."""

    scene: str
    output: str
    path: str | None
    cameras: Path | None
    frames: int
    fps: float
    size: tuple[int, int] | None
    background: str
    threads: int | None


def film(request: RenderRequest, quiet: bool) -> None:
    """Render what was asked for.

    Raises:
        Styl3rError: the scene, the cameras or the output is unusable.
    """
    console = Console(quiet)
    background = parse_colour(request.background)
    _check(request)
    with console.stage("scene"):
        scene = read_scene(read_stdin() if request.scene == STDOUT else Path(request.scene))
        for note in scene.notes:
            console.note(note)
        cameras = _frame_cameras(request, scene, console)
    with console.stage("render", len(cameras)) as drawn:
        pictures = draw_path(scene.gaussians, cameras, background, request.threads, drawn)
        _write(request, pictures, len(cameras))


def parse_colour(text: str) -> Colour:
    """A colour's name, #rrggbb, rgb(r,g,b) or hsl(...) as sRGB in [0, 1].

    Raises:
        UsageError: it is none of them.
    """
    from PIL import ImageColor

    try:
        red, green, blue = ImageColor.getrgb(text)[:3]
    except ValueError as error:
        message = f"--background '{text}': not a colour such as white, #203040 or rgb(32,48,64)"
        raise UsageError(message) from error
    return red / 255, green / 255, blue / 255


def _check(request: RenderRequest) -> None:
    """Refuse outputs that could not be written, before anything is read."""
    if request.output == STDOUT:
        check_stdout("-o -")
        return
    path = Path(request.output).expanduser()
    if path.suffix.lower() not in (VIDEO_SUFFIX, PICTURE_SUFFIX):
        raise UsageError(f"-o {path}: name a video (OUT.mp4) or pictures (DIR/%04d.png)")
    if _is_pattern(path):
        _make_folder(path.parent)
        path = _numbered(path, 0)
    read = [Path(request.scene)] if request.scene != STDOUT else []
    check_outputs([path], read + ([request.cameras] if request.cameras else []))


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot make the folder {folder}: {error.strerror}") from error


def _frame_cameras(request: RenderRequest, scene: Scene, console: Console) -> list[Camera]:
    """The camera of every frame."""
    if request.cameras is not None:
        from styl3r_cli.cameras.transforms import read_transforms

        file = read_transforms(request.cameras)
        for note in file.notes:
            console.note(note)
        cameras = file.cameras
    else:
        stored = cameras_from_metadata(scene.metadata)
        cameras = [enlarged(camera, LEAST_SIDE) for camera in stored]
    if request.path is not None:
        cameras = make_path(request.path, cameras, scene.gaussians, request.frames)
    if request.size is not None:
        cameras = [cropped(camera, *request.size) for camera in cameras]
    return cameras


def _write(request: RenderRequest, pictures: Iterable[Picture], count: int) -> None:
    path = Path(request.output).expanduser()
    if request.output == STDOUT or path.suffix.lower() == VIDEO_SUFFIX:
        from styl3r_cli.video import write_video

        whole = io.BytesIO()
        write_video(whole if request.output == STDOUT else path, pictures, request.fps)
        if request.output == STDOUT:
            write_stdout(whole.getvalue())
    elif _is_pattern(path):
        for index, picture in enumerate(pictures):
            write_png(_numbered(path, index), picture)
    elif count == 1:
        write_png(path, next(iter(pictures)))
    else:
        raise UsageError(f"-o {path}: {count} frames need numbered names, such as %04d.png")


def _is_pattern(path: Path) -> bool:
    """Whether the name has a place for the frame's number, as C's printf and ffmpeg write it."""
    return re.search(r"%0?\d*d", path.name) is not None


def _numbered(path: Path, index: int) -> Path:
    """The name of one frame, counted from 0."""
    try:
        return path.with_name(path.name % index)
    except (TypeError, ValueError) as error:
        raise UsageError(f"-o {path}: one frame number, such as %04d, and no other %") from error
