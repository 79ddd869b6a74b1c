"""What can be refused before the work begins, so that no minute of it is lost."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from pathlib import Path

from styl3r_cli.errors import OutputError, UsageError
from styl3r_cli.files import STDOUT_CLOSED, stdout_is_closed
from styl3r_cli.names import real_path
from styl3r_cli.pipes import is_pipe


def check_outputs(
    outputs: Iterable[Path],
    inputs: Iterable[Path],
    prints: bool = False,
    makes: Iterable[Path] = (),
) -> None:
    """Make sure that results can be written where they were asked for, each in its own place.

    Args:
        outputs: files that will be written.
        inputs: files that will be read.
        prints: whether a report goes to standard output as well.
        makes: folders that `make_folder` will make once all inputs are read.

    Raises:
        UsageError: a result would replace something that is read, or another result.
        OutputError: a folder is missing, or may not be written to; standard output is closed.
    """
    if prints:
        check_printable()
    read = {real_path(path) for path in inputs}
    taken: set[Path] = set()
    made = {real_path(folder) for folder in makes if not _is_there(folder)}
    for path in outputs:
        target = real_path(path)
        if target in read:
            raise UsageError(f"{path} is also an input; results never replace what they come from")
        if target in taken or (prints and _is_stdout(target)):
            raise UsageError(f"{path} would be two results; give each a file of its own")
        taken.add(target)
        try:
            if target.parent in made:
                _above(target.parent).joinpath(target.name).exists()  # or its name is too long
            else:
                _check_place(path, target)
        except OSError as error:
            raise OutputError(f"cannot write {path}: {error.strerror or error}") from error


def make_folder(folder: Path) -> None:
    """Make a folder for results, and those above it.

    Raises:
        OutputError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(_cannot_make(folder, error.strerror)) from error


def _is_there(folder: Path) -> bool:
    """Whether a folder for results need not be made; raises OutputError if it cannot be."""
    try:
        if folder.is_dir():
            return True
        above = _above(folder)
    except OSError as error:
        raise OutputError(_cannot_make(folder, error.strerror)) from error
    if not above.is_dir():
        raise OutputError(_cannot_make(folder, f"{above} is a file"))
    if not os.access(above, os.W_OK | os.X_OK):
        raise OutputError(_cannot_make(folder, "Permission denied"))
    return False


def _above(folder: Path) -> Path:
    """The nearest place above a folder, itself included, that exists."""
    return next(place for place in (folder, *folder.absolute().parents) if place.exists())


def _cannot_make(folder: Path, why: str | None) -> str:
    return f"cannot make the folder {folder}: {why}"


def _is_stdout(target: Path) -> bool:
    """Whether standard output was redirected to that very file."""
    try:
        return target.is_file() and os.path.samestat(target.stat(), os.fstat(sys.stdout.fileno()))
    except (OSError, ValueError):  # no file is open there
        return False


def _check_place(path: Path, target: Path) -> None:
    if target.is_symlink() and not is_pipe(target):
        raise OutputError(f"cannot write {path}: a loop of links")
    if target.is_dir():
        raise OutputError(f"cannot write {path}: it is a folder; name a file in it")
    if not target.parent.is_dir():
        folder = target.parent if path.is_symlink() else path.parent
        raise OutputError(f"cannot write {path}: the folder {folder} does not exist")
    if not os.access(target if target.exists() else target.parent, os.W_OK):
        raise OutputError(f"cannot write {path}: permission denied")


def check_printable() -> None:
    """Make sure that there is a standard output to print a report to.

    Raises:
        OutputError: it is closed.
    """
    if stdout_is_closed():
        raise OutputError(STDOUT_CLOSED)


def check_stdout(option: str) -> None:
    """Make sure that binary data can go to standard output and does not end on a terminal.

    Raises:
        OutputError: it is closed.
        UsageError: it is a terminal.
    """
    check_printable()
    if sys.stdout.isatty():
        message = "standard output is a terminal; pipe it into a program or name a file"
        raise UsageError(f"{option}: {message}")


def check_suffix(path: Path, suffix: str, option: str) -> None:
    """Make sure that a result's name says the format that it will have.

    Raises:
        UsageError: it does not.
    """
    if path.suffix.lower() != suffix:
        raise UsageError(f"{option} {path}: the file's name must end in {suffix}")
