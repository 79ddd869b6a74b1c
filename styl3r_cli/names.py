"""Paths as users type them, for all that a file system may hold: nothing here raises."""

from __future__ import annotations

import os
from pathlib import Path

from styl3r_cli.pipes import is_pipe


def user_path(text: str | Path) -> Path:
    """The path with `~` and `~user` understood; of a user who is not there, as it is.

    (pathlib's own raises for the latter, and where there is no home at all.)
    """
    return Path(os.path.expanduser(text))  # noqa: PTH111


def real_path(path: Path) -> Path:
    """The path without links; a loop of links ends in a link again (pathlib's own raises).

    A link of the system's to a pipe stays: what /dev/stdout, or the /dev/fd/63 of a shell's
    `>(program)`, leads to has no name in any folder.
    """
    try:
        real = Path(os.path.realpath(path))
    except (OSError, ValueError):  # this process's folder was removed; a NUL in the name
        return path
    return path if is_pipe(path) and not is_pipe(real) else real
