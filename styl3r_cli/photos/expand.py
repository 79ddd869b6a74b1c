"""From what a user types (files, globs, a folder) to an ordered list of photo files."""

from __future__ import annotations

import glob
import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import takewhile
from pathlib import Path

from styl3r_cli.errors import InputError
from styl3r_cli.names import user_path
from styl3r_cli.pipes import is_pipe

JPEG = (".jpg", ".jpeg", ".jpe")
HEIF = (".heic", ".heif", ".hif", ".avif")
OTHERS = (".png", ".webp", ".tif", ".tiff", ".bmp", ".gif", ".ppm", ".pgm")
PHOTO_SUFFIXES = frozenset((*JPEG, *HEIF, *OTHERS))
ANY_DEPTH = "**"  # in a glob: folders in folders
NAMED_IN_A_NOTE = 5  # longer lists of skipped files hide the message


def expand(
    arguments: Sequence[str], notes: list[str] | None = None, listed: Sequence[str] = ()
) -> list[Path]:
    """The photo files that the arguments name, arguments in order, each sorted naturally.

    A file is taken as it is, whatever its suffix. A folder gives the photos directly in it, and a
    glob (for shells that do not expand it) the photos that it matches; in both, hidden files are
    ignored and files with other suffixes are skipped. A file that a folder or a glob names again
    is not repeated. The argument "-" stands for a list of files and folders, in the list's order.

    Args:
        arguments: files, folders and globs; `~` is understood.
        notes: gets a line on what was skipped.
        listed: the names that "-" stands for; nothing in them is special.

    Returns:
        Existing files; never empty unless `arguments` is.

    Raises:
        InputError: an argument names nothing, or a folder holds no photo.
    """
    found: list[Path] = []
    for argument, path in _paths(arguments, listed):
        if path.is_file():
            found.append(path)
        elif path.is_dir():
            photos = _photos_only(argument, path.iterdir(), notes)
            if not photos:
                raise InputError(f"{argument}: no photos in this folder (JPEG, PNG, WebP, TIFF...)")
            found += [photo for photo in photos if photo not in found]
        elif argument not in listed and glob.has_magic(argument):
            photos = _photos_only(argument, _matches(path), notes)
            if not photos:
                raise InputError(f"{argument}: no photo matches this pattern")
            found += [photo for photo in photos if photo not in found]
        else:
            raise InputError(_not_found(argument, path))
    return found


def _matches(pattern: Path) -> Iterator[Path]:
    """What a glob matches; `**` enters no hidden folder, and no link, which may go round."""
    if ANY_DEPTH not in pattern.parts:
        yield from map(Path, glob.glob(str(pattern)))  # noqa: PTH207
        return
    plain = list(takewhile(lambda part: not glob.has_magic(part), pattern.parts))
    rest = [p if p == ANY_DEPTH else re.sub(r"\*+", "*", p) for p in pattern.parts[len(plain) :]]
    if rest[-1] == ANY_DEPTH:
        rest.append("*")
    folder = Path(*plain)
    for path in folder.glob(str(Path(*rest))):
        inside = path.relative_to(folder).parts
        if not any(part.startswith(".") for part in inside):
            yield path


def _paths(arguments: Sequence[str], listed: Sequence[str]) -> Iterator[tuple[str, Path]]:
    """Arguments as they are shown and as paths, with the list in the place of "-"."""
    for argument in arguments:
        if argument == "-":
            yield from ((name, Path(name)) for name in listed)
        else:
            yield argument, user_path(argument)


def natural_key(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """Sorts img2 before img10, and upper case with lower case."""
    parts = re.split(r"(\d+)", str(path).casefold())
    key = [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts if part]
    return key, str(path)


def _photos_only(argument: str, paths: Iterable[Path], notes: list[str] | None) -> list[Path]:
    files = [path for path in paths if not path.name.startswith(".") and path.is_file()]
    photos = [path for path in files if path.suffix.lower() in PHOTO_SUFFIXES]
    skipped = sorted(set(files) - set(photos), key=natural_key)
    if skipped and notes is not None:
        notes.append(f"{argument}: skipped {name_some(path.name for path in skipped)} (no photos)")
    return sorted(photos, key=natural_key)


def name_some(names: Iterable[str]) -> str:
    """The first few of the names, and how many more there are."""
    listed = list(names)
    shown = ", ".join(listed[:NAMED_IN_A_NOTE])
    more = len(listed) - NAMED_IN_A_NOTE
    return f"{shown} and {more} more" if more > 0 else shown


def _not_found(argument: str, path: Path) -> str:
    if is_pipe(path):
        return f"{argument}: a pipe; photos are files (a style may come through a pipe)"
    if path.exists():
        return f"{argument}: neither a file nor a folder"
    if path.is_symlink():
        return f"{argument}: this link points to a file that does not exist"
    if str(path.parent) not in (".", "") and not path.parent.is_dir():
        return f"{argument}: not found (there is no folder {path.parent})"
    return f"{argument}: no such file or folder"
