"""`--each`: one scene a style from one run, and what its files are called."""

from __future__ import annotations

import unicodedata
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from styl3r_cli.commands.options import STDOUT, WeightedStyle
from styl3r_cli.errors import UsageError

if TYPE_CHECKING:
    from styl3r_cli.commands.request import SceneRequest

PLACE = "{style}"  # in an output's name, where the style's name goes


def one_by_one(request: SceneRequest) -> list[SceneRequest]:
    """The request for each of its scenes: with `--each` one per style, else itself.

    None of several has the file of cameras: they are the same for every style.
    """
    if not request.each:
        return [request]
    return [
        replace(
            request,
            styles=(style,),
            output=str(_named(request.scene_path, name)),
            video=_named(request.video, name),
            preview=_named(request.preview, name),
            cameras_out=None,
        )
        for style, name in zip(request.styles, _names(request.styles), strict=True)
    ]


def outputs_of(request: SceneRequest) -> list[Path]:
    """Every file that a request asks for."""
    paths = (request.scene_path, request.video, request.preview, request.cameras_out)
    return [path for path in paths if path is not None]


def check_each(request: SceneRequest) -> None:
    """Refuse names that several scenes would share, and what means nothing to one style alone.

    Raises:
        UsageError: an output has no place for the style's name, or the cameras' file has one; a
            style has a weight. Without `--each`: an output has such a place. A folder has one.
    """
    for output in outputs_of(request):
        if PLACE in str(output.parent) and request.styles:
            raise UsageError(f"{output}: {PLACE} can be in a file's name, not in a folder's")
    if not request.each:
        return _check_alone(request)
    for style in request.styles:
        if style.weight != 1:
            raise UsageError(f"--style {style.path}: weights are for a blend; --each makes none")
    if request.cameras_out is not None and PLACE in request.cameras_out.name:
        raise UsageError(
            f"--cameras-out {request.cameras_out}: one file for all styles; leave {PLACE} out"
        )
    if request.output == STDOUT:
        raise UsageError(f"--each writes several scenes; name them -o DIR/{PLACE}.ply")
    for option, path in (
        ("-o", request.scene_path),
        ("--video", request.video),
        ("--preview", request.preview),
    ):
        if path is not None and PLACE not in path.name:
            raise UsageError(f"{option} {path}: with --each the file's name needs {PLACE} in it")


def _check_alone(request: SceneRequest) -> None:
    for path in outputs_of(request):
        if PLACE in path.name and request.styles:
            raise UsageError(f"{path}: {PLACE} is for --each, one scene a style; add that option")


def _names(styles: tuple[WeightedStyle, ...]) -> list[str]:
    """A name per style: its file's, with a number where that is taken on any file system."""
    names: dict[str, str] = {}
    for style in styles:
        name, number = style.path.stem, 2
        while _folded(name) in names:
            name, number = f"{style.path.stem}-{number}", number + 1
        names[_folded(name)] = name
    return list(names.values())


def _folded(name: str) -> str:
    """Equal for names that macOS or Windows take for one: of other case, say."""
    return unicodedata.normalize("NFC", name.casefold())


def _named(pattern: Path | None, name: str) -> Path | None:
    if pattern is None:
        return None
    return pattern.with_name(pattern.name.replace(PLACE, name))
