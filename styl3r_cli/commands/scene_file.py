"""A scene as the command line names it: a file, or standard input."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from styl3r_cli.cameras.stored import damage
from styl3r_cli.commands.options import STDOUT
from styl3r_cli.errors import InputError, OutOfMemoryError, UsageError
from styl3r_cli.files import read_file, read_stdin
from styl3r_cli.formats import Scene, begins, read_scene, recognise, scene_suffix
from styl3r_cli.incoming import Kind
from styl3r_cli.names import user_path
from styl3r_cli.pipes import is_pipe


@dataclass(frozen=True)
class SceneFile:
    """A scene that was read.

    Attributes:
        scene: what is in it.
        suffix: its format.
        size: its bytes.
    """

    scene: Scene
    suffix: str
    size: int


def check_two(source: str, other: Path | None) -> None:
    """Make sure that two scenes do not both come from standard input, which is there once.

    Raises:
        UsageError: they do.
    """
    if source == STDOUT and other == Path(STDOUT):
        raise UsageError("--compare -: standard input is one scene; name a file for the other")


def load(source: str, kind: str | None = None) -> SceneFile:
    """Read a scene file, or standard input if it is called "-".

    Args:
        source: what the user named.
        kind: the format's suffix without its dot; by default the file's own, or what the bytes
            look like.

    Raises:
        UsageError: no format has the file's suffix.
        InputError: it cannot be read, or is damaged.
        OutOfMemoryError: it does not fit.
    """
    try:
        file = _loaded(source, f".{kind}" if kind else None)
    except MemoryError as error:
        what = "the scene on standard input" if source == STDOUT else source
        raise OutOfMemoryError(f"out of memory: {what} does not fit") from error
    notes = [*file.scene.notes, *damage(file.scene.metadata)]
    return replace(file, scene=replace(file.scene, notes=notes))


def _loaded(source: str, suffix: str | None) -> SceneFile:
    if source == STDOUT:
        data = read_stdin(Kind("a scene", begins=lambda begun: begins(begun, suffix, STDOUT)))
        suffix = suffix or recognise(data) or ""
        return SceneFile(read_scene(data, suffix or None), suffix, len(data))
    path = user_path(source)
    if is_pipe(path):  # its name, /dev/fd/63 say, tells nothing
        data = _through_pipe(path, suffix)
        suffix = suffix or recognise(data) or ""
        return SceneFile(read_scene(data, suffix or None, str(path)), suffix, len(data))
    suffix = suffix or scene_suffix(path)
    scene = read_scene(path, suffix)
    try:
        return SceneFile(scene, suffix, path.stat().st_size)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def _through_pipe(path: Path, suffix: str | None) -> bytes:
    try:
        return read_file(
            path, Kind("a scene", begins=lambda begun: begins(begun, suffix, str(path)))
        )
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
