"""Options that several commands share, and the types of their values."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import click
from click.shell_completion import CompletionItem

from styl3r_cli import console
from styl3r_cli.names import user_path
from styl3r_cli.quality import KEPT_DECIBELS

STDOUT = "-"
LOOP_FRAMES, LOOP_FPS = 72, 24.0  # a path's one loop in three seconds: slow enough to look around
Command = TypeVar("Command", bound=Callable[..., Any])


class WeightedStyle(NamedTuple):
    """A style picture's file and how much it counts beside others."""

    path: Path
    weight: float


class StyleType(click.ParamType):
    """ART or ART=WEIGHT; a file that is really called that is never split."""

    name = "ART[=WEIGHT]"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> WeightedStyle:
        """Split a weight off, if what follows the last "=" is a number."""
        if isinstance(value, WeightedStyle):
            return value
        FILE.convert(value, param, ctx)
        path, separator, weight = str(value).rpartition("=")
        if separator and path and not user_path(value).exists():
            try:
                return WeightedStyle(user_path(path), float(weight))
            except ValueError:
                pass  # part of the file's name
        return WeightedStyle(user_path(value), 1.0)


class SizeType(click.ParamType):
    """SIDE or WIDTHxHEIGHT in pixels, as (width, height)."""

    name = "WxH"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        """One number is a square."""
        if isinstance(value, tuple):
            return value
        match = re.fullmatch(r"(\d{1,5})(?:x(\d{1,5}))?", str(value).strip().lower())
        if not match or not int(match[1]) or (match[2] and not int(match[2])):
            self.fail(f"'{value}' is not a size such as 256 or 640x480", param, ctx)
        return int(match[1]), int(match[2] or match[1])


class Number(click.FloatRange):
    """A number in a range; click's own type takes "nan" for one."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Refuse what is not finite."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number", param, ctx)
        return number


class UserPath(click.ParamType):
    """A path, with `~` understood also where the shell does not (--option=~/file)."""

    name = "FILE"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Refuse what no file can be called."""
        if not str(value) or "\0" in str(value):
            self.fail("the file name is empty", param, ctx)
        return user_path(value)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Leave it to the shell, which knows its files."""
        return [CompletionItem(incomplete, type="file")]


class FileName(click.ParamType):
    """What may be a file's name or something else, such as `-`: taken as it is."""

    name = "FILE"
    shell_complete = UserPath.shell_complete

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Refuse what no file can be called."""
        if not str(value) or "\0" in str(value):
            self.fail("the file name is empty", param, ctx)
        return str(value)


class PathName(FileName):
    """A camera path by name, or a file."""

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """The names, and what the shell finds."""
        from styl3r_cli.cameras.paths import PATHS

        names = [CompletionItem(n, help=PATHS[n]) for n in PATHS if n.startswith(incomplete)]
        return [*names, CompletionItem(incomplete, type="file")]


FILE = FileName()


def apply(decorators: list[Callable[[Command], Command]]) -> Callable[[Command], Command]:
    """Several decorators as one, in the order in which --help lists them."""

    def decorate(command: Command) -> Command:
        for decorator in reversed(decorators):
            command = decorator(command)
        return command

    return decorate


def _log(_ctx: click.Context, _param: click.Parameter, value: str | None) -> None:
    if value is not None:
        console.use_format(value)


quiet_option = apply(
    [
        click.option("--quiet", "-q", is_flag=True, help="No notes and no progress."),
        click.option(
            "--log",
            type=click.Choice(console.LOG_FORMATS),
            is_eager=True,
            expose_value=False,
            callback=_log,
            help="Notes, progress and errors on standard error as text (the default) or as one "
            "JSON object a line.",
        ),
    ]
)
threads_option = click.option(
    "--threads", type=click.IntRange(min=1), help="Processor cores to use; all by default."
)

# What `stylize` and `reconstruct` have in common; see commands/scene.py.
scene_options = apply(
    [
        click.argument("photos", nargs=-1, required=True, metavar="PHOTOS...|-"),
        click.option(
            "--null",
            "-0",
            is_flag=True,
            help="The photos' names on standard input end in NUL, as `find -print0` writes them.",
        ),
        click.option(
            "--output",
            "-o",
            required=True,
            type=FileName(),
            metavar="SCENE.ply|-",
            help="The scene, for any 3D Gaussian viewer; '-' writes it to standard output.",
        ),
        click.option(
            "--video",
            type=UserPath(),
            metavar="OUT.mp4",
            help="A camera swing (.mp4, .webm, .gif or .webp).",
        ),
        click.option(
            "--preview",
            type=UserPath(),
            metavar="SHEET.png",
            help="One picture that shows photos, style and result side by side.",
        ),
        click.option(
            "--cameras-out",
            type=UserPath(),
            metavar="TRANSFORMS.json",
            help="Where the photos were taken from (nerfstudio's transforms.json).",
        ),
        click.option(
            "--cameras",
            type=UserPath(),
            metavar="TRANSFORMS.json",
            help="Known focal lengths of the photos, in the same format.",
        ),
        click.option(
            "--fov",
            type=float,
            metavar="DEGREES",
            help="Horizontal field of view of the photos; by default from EXIF, or assumed.",
        ),
        click.option(
            "--size",
            type=SizeType(),
            metavar="SIDE|WxH",
            help="What the photos are scaled and cropped to, multiples of 16; "
            "by default what the model was trained on (256).",
        ),
        click.option(
            "--keep-db",
            type=Number(10, 90),
            metavar="DB",
            help="Keep only as many Gaussians as show what all of them do to so many decibels, "
            f"from the photos' cameras and between them; {KEPT_DECIBELS:g}, which nobody sees, "
            "with --quality best.",
        ),
        click.option(
            "--all",
            "keep_all",
            is_flag=True,
            help="Keep every Gaussian: one a pixel, of each surface one photo's.",
        ),
        click.option(
            "--model",
            type=FILE,
            default="mini",
            show_default=True,
            metavar="NAME|DIR",
            help="The network.",
        ),
        click.option(
            "--device",
            type=click.Choice(["auto", "cpu", "cuda"]),
            default="auto",
            show_default=True,
            help="What the network runs on.",
        ),
        threads_option,
        click.option("--json", is_flag=True, help="Print a report as one JSON object."),
        quiet_option,
    ]
)
