"""What can be refused before the work begins, so that no minute of it is lost."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable
from pathlib import Path

from styl3r_cli.errors import OutputError, UsageError
from styl3r_cli.names import real_path


def check_outputs(outputs: Iterable[Path], inputs: Iterable[Path]) -> None:
    """Make sure that results can be written where they were asked for.

    Raises:
        UsageError: a result would replace something that is read.
        OutputError: a folder is missing, or may not be written to.
    """
    read = {real_path(path) for path in inputs}
    for path in outputs:
        target = real_path(path)
        if target in read:
            raise UsageError(f"{path} is also an input; results never replace what they come from")
        try:
            _check_place(path, target)
        except OSError as error:
            raise OutputError(f"cannot write {path}: {error.strerror or error}") from error


def _check_place(path: Path, target: Path) -> None:
    if target.is_symlink():
        raise OutputError(f"cannot write {path}: a loop of links")
    if target.is_dir():
        raise OutputError(f"cannot write {path}: it is a folder; name a file in it")
    if not target.parent.is_dir():
        folder = target.parent if path.is_symlink() else path.parent
        raise OutputError(f"cannot write {path}: the folder {folder} does not exist")
    if not os.access(target if target.exists() else target.parent, os.W_OK):
        raise OutputError(f"cannot write {path}: permission denied")


def check_stdout(option: str) -> None:
    """Make sure that binary data can go to standard output and does not end on a terminal.

    Raises:
        OutputError: it is closed.
        UsageError: it is a terminal.
    """
    if sys.stdout is None:
        raise OutputError("cannot write standard output: it is closed")
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
