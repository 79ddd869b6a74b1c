"""What `render` does: a scene and cameras in, a video or numbered frames out."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from styl3r_cli import __version__
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
from styl3r_cli.frames import Colour, draw_path, enlarged, write_png
from styl3r_cli.gaussians import Gaussians

VIDEO, PICTURE, LINEAR = ".mp4", ".png", ".exr"
DEFAULT_BACKGROUND = "black"
SCENE_KEYS = ("generator", "model")  # of a scene's metadata, for the frames made of it
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
    background: str | None
    threads: int | None

    @property
    def kind(self) -> str:
        """The suffix of the output, in lower case; standard output gets a video."""
        return VIDEO if self.output == STDOUT else Path(self.output).suffix.lower()


def film(request: RenderRequest, quiet: bool) -> None:
    """Render what was asked for.

    Raises:
        Styl3rError: the scene, the cameras or the output is unusable.
    """
    console = Console(quiet)
    asked = request.background
    background = parse_colour(DEFAULT_BACKGROUND if asked is None else asked)
    _check(request)
    with console.stage("scene"):
        scene = read_scene(read_stdin() if request.scene == STDOUT else Path(request.scene))
        for note in scene.notes:
            console.note(note)
        cameras = _frame_cameras(request, scene, console)
    with console.stage("render", len(cameras)) as drawn:
        if request.kind == LINEAR:
            _write_linear(request, scene, cameras, drawn)
        else:
            _write(request, scene.gaussians, cameras, background, drawn)


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
    if request.kind not in (VIDEO, PICTURE, LINEAR):
        raise UsageError(f"-o {path}: name a video (OUT.mp4) or frames (DIR/%04d.png, .exr)")
    if request.kind == LINEAR and request.background is not None:
        raise UsageError("--background: EXR frames keep their alpha; put them on anything later")
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


def _write(
    request: RenderRequest,
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    background: Colour,
    drawn: Callable[[], None],
) -> None:
    """A video, or PNG pictures."""
    path = Path(request.output).expanduser()
    pictures = draw_path(gaussians, cameras, background, request.threads, drawn)
    if request.kind == VIDEO:
        from styl3r_cli.video import write_video

        whole = io.BytesIO()
        write_video(whole if request.output == STDOUT else path, pictures, request.fps)
        if request.output == STDOUT:
            write_stdout(whole.getvalue())
        return
    names = _frame_names(path, len(cameras))
    for name, picture in zip(names, pictures, strict=True):
        write_png(name, picture)


def _write_linear(
    request: RenderRequest, scene: Scene, cameras: Sequence[Camera], drawn: Callable[[], None]
) -> None:
    """EXR frames, with what the scene says of its own origin."""
    from styl3r_cli.exr import write_exr
    from styl3r_cli.splatting import render

    told = {key: scene.metadata[key] for key in SCENE_KEYS if key in scene.metadata}
    provenance = {"software": f"styl3r {__version__}"}
    provenance |= {f"styl3r.{key}": value for key, value in told.items()}
    names = _frame_names(Path(request.output).expanduser(), len(cameras))
    for name, camera in zip(names, cameras, strict=True):
        frame = render(scene.gaussians, camera, None, threads=request.threads)
        write_exr(name, frame, camera, provenance)
        drawn()


def _frame_names(path: Path, count: int) -> list[Path]:
    """A file for each frame; one frame alone needs no number."""
    if _is_pattern(path):
        return [_numbered(path, index) for index in range(count)]
    if count > 1:
        message = f"{count} frames need numbered names, such as %04d{path.suffix}"
        raise UsageError(f"-o {path}: {message}")
    return [path]


def _is_pattern(path: Path) -> bool:
    """Whether the name has a place for the frame's number, as C's printf and ffmpeg write it."""
    return re.search(r"%0?\d*d", path.name) is not None


def _numbered(path: Path, index: int) -> Path:
    """The name of one frame, counted from 0."""
    try:
        return path.with_name(path.name % index)
    except (TypeError, ValueError) as error:
        raise UsageError(f"-o {path}: one frame number, such as %04d, and no other %") from error
