"""What the command line asks of `render`, and what can be refused before the work begins."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from styl3r_cli.commands.checks import check_outputs, check_stdout, check_suffix, make_folder
from styl3r_cli.commands.options import STDOUT
from styl3r_cli.commands.scene_file import check_two
from styl3r_cli.errors import UsageError
from styl3r_cli.frames import SURROUNDINGS, Background, Colour
from styl3r_cli.movies import FILES as MOVIES
from styl3r_cli.movies import PIPED
from styl3r_cli.names import user_path
from styl3r_cli.quality import BEST

PICTURES = ("png", "jpg")
LINEAR = "exr"
FORMATS = (*MOVIES, "y4m", "rgb", "png", "jpg", LINEAR)
# The longest side that a format can say (and x264 encode), in pixels.
LONGEST_SIDES = {"mp4": 16384, "webm": 65535, "webp": 16383, "gif": 65535, "jpg": 65500}
# A number of thousands of digits is no file's name, whether they are its width or its precision.
TOO_WIDE = r"%[-+ #\d.]*\d{4}"
WITH_ALPHA = ("webm", "webp", "png", "rgb")
TRANSPARENT = "transparent"


@dataclass(frozen=True)
class RenderRequest:
    """The options of `render`, as the command line gave them.

    Without a path, every camera of the file is one frame. `arc` is in degrees, as `fov` is.
    """

    scene: str
    output: str
    format: str | None
    path: str | None
    cameras: Path | None
    save_path: Path | None
    frames: int | None
    fps: float | None
    loop: bool
    eased: bool | None
    amplitude: float
    arc: float | None
    size: tuple[int, int] | None
    fov: float | None
    background: str | None
    compare: Path | None
    layout: str
    show: str
    colour_map: str
    exr_compression: str
    exr_parts: str
    antialias: bool
    threads: int | None
    quality: str = BEST

    @property
    def kind(self) -> str:
        """The output's format: as asked for, else by its suffix; MP4 for standard output."""
        return self.format or ("mp4" if self.output == STDOUT else self.named)

    @property
    def named(self) -> str:
        """The suffix of the output's name, without its dot: maybe a format's."""
        return self.file.suffix.lower().removeprefix(".").replace("jpeg", "jpg")

    @property
    def file(self) -> Path:
        """The output's name, or the pattern of its frames' names."""
        return user_path(self.output)

    @property
    def beside(self) -> int:
        """How many pictures a frame shows beside each other."""
        two = self.layout == "side" if self.compare else self.show == "both"
        return 2 if two else 1

    @property
    def one_file(self) -> bool:
        """Whether all frames go into one file or through a pipe."""
        return self.output == STDOUT or self.kind not in (*PICTURES, LINEAR)


def background_of(request: RenderRequest) -> Background | None:
    """What is behind the scene; None for nothing.

    Raises:
        UsageError: it is no colour, or the format has no alpha.
    """
    asked = SURROUNDINGS if request.background is None else request.background
    if asked == SURROUNDINGS:
        return SURROUNDINGS
    if asked != TRANSPARENT:
        return parse_colour(asked)
    if request.kind not in (*WITH_ALPHA, LINEAR):
        formats = ", ".join(WITH_ALPHA)
        raise UsageError(f"--background transparent: {request.kind} has no alpha; use {formats}")
    if request.compare or request.show != "colour":
        raise UsageError("--background transparent is for pictures of one scene in its colours")
    return None


def parse_colour(text: str) -> Colour:
    """A colour's name, #rrggbb, rgb(r,g,b) or hsl(...) as sRGB in [0, 1].

    Raises:
        UsageError: it is none of them.
    """
    from PIL import ImageColor

    try:
        values: tuple[int, ...] = ImageColor.getrgb(text)
    except ValueError:
        values = ()
    # Colours that are half transparent are none, as a background is opaque; nor are brighter ones.
    if len(values) != 3 or max(values) > 255:
        message = f"--background '{text}': not a colour such as white, #203040 or rgb(32,48,64)"
        raise UsageError(message)
    red, green, blue = values
    return red / 255, green / 255, blue / 255


def check(request: RenderRequest) -> None:
    """Refuse outputs that could not be written, before anything is read.

    Raises:
        UsageError: the wishes do not go together.
        OutputError: the place cannot be written to.
    """
    _check_kind(request)
    check_two(request.scene, request.compare)
    outputs = [request.save_path] if request.save_path else []
    makes: list[Path] = []
    for path in outputs:  # a file of anything else is named by mistake, and would be lost
        check_suffix(path, ".json", "--save-path")
    if request.output == STDOUT:
        check_stdout("-o -")
    elif _is_numbered(request):
        outputs.append(numbered(request.file, 0))
        makes.append(request.file.parent)
    else:
        outputs.append(request.file)
    check_outputs(outputs, _inputs(request), makes=makes)


def check_frames(request: RenderRequest, count: int) -> None:
    """Refuse frames whose files would replace something, before the first is drawn.

    Raises:
        UsageError: one is an input or the file of cameras, or there is no place for a number.
        OutputError: the place of one cannot be written to.
    """
    if _is_numbered(request):
        make_folder(request.file.parent)
    if not request.one_file:
        others = [request.save_path] if request.save_path else []
        check_outputs([*others, *frame_names(request.file, count)], _inputs(request))


def stays_behind(request: RenderRequest, count: int) -> Path | None:
    """The frame of an earlier, longer film that would follow on these; None without one."""
    after = numbered(request.file, count) if _is_numbered(request) else None
    return after if after and after.exists() else None


def _is_numbered(request: RenderRequest) -> bool:
    return request.output != STDOUT and not request.one_file and is_pattern(request.file)


def _inputs(request: RenderRequest) -> list[Path]:
    named = [request.cameras, request.compare]
    if request.scene != STDOUT:
        named.append(user_path(request.scene))
    if request.path is not None:  # a movement's name is no file that is in the way
        named.append(user_path(request.path))
    return [path for path in named if path is not None]


def _check_kind(request: RenderRequest) -> None:
    kind = request.kind
    if kind not in FORMATS:
        raise UsageError(
            f"-o {request.file}: name a video (OUT.mp4, .webm, .gif, .webp, .y4m) or frames "
            "(DIR/%04d.png, .jpg, .exr)"
        )
    if request.named in FORMATS and request.named != kind:
        raise UsageError(f"-o {request.file} and --format {kind} contradict each other; drop one")
    if request.output == STDOUT and kind in ("jpg", LINEAR):
        raise UsageError(f"-o -: {kind} frames need files; through a pipe go {', '.join(PIPED)}")
    if kind == LINEAR and request.background is not None:
        raise UsageError("--background: EXR frames keep their alpha; put them on anything later")
    if kind == LINEAR and request.quality != BEST:
        raise UsageError(f"--quality {request.quality}: EXR frames are always the best")
    if kind == LINEAR and (request.compare or request.show != "colour"):
        raise UsageError("--compare and --show: EXR frames have colour and depth of one scene")


def check_size(request: RenderRequest, width: int, height: int) -> None:
    """Refuse frames that are longer than their format allows, before one is drawn.

    Raises:
        UsageError: they are.
    """
    longest = LONGEST_SIDES.get(request.kind)
    width *= request.beside
    if longest is not None and max(width, height) > longest:
        message = f"{width}x{height} pixels; a .{request.kind} has at most {longest} a side"
        raise UsageError(f"-o {request.output}: {message} (--size)")


def frame_names(path: Path, count: int) -> list[Path]:
    """A file for each frame; one frame alone needs no number.

    Raises:
        UsageError: several frames, and no place for a number in the name.
    """
    if is_pattern(path):
        return [numbered(path, index) for index in range(count)]
    if count > 1:
        message = f"{count} frames need numbered names, such as %04d{path.suffix}"
        raise UsageError(f"-o {path}: {message}")
    return [path]


def is_pattern(path: Path) -> bool:
    """Whether the name has a place for the frame's number, as C's printf and ffmpeg write it."""
    return re.search(r"%0?\d*d", path.name) is not None


def numbered(path: Path, index: int) -> Path:
    """The name of one frame, counted from 0.

    Raises:
        UsageError: there is more than one place, or one for something else.
    """
    refusal = UsageError(f"-o {path}: one frame number, such as %04d, and no other %")
    if re.search(TOO_WIDE, path.name):
        raise refusal
    try:
        return path.with_name(path.name % index)
    except (TypeError, ValueError) as error:
        raise refusal from error
