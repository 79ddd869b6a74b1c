"""Paths as users type them, for all that a file system may hold: nothing here raises."""

from __future__ import annotations

import os
from pathlib import Path


def user_path(text: str | Path) -> Path:
    """The path with `~` and `~user` understood; of a user who is not there, as it is.

    (pathlib's own raises for the latter, and where there is no home at all.)
    """
    return Path(os.path.expanduser(text))  # noqa: PTH111


def real_path(path: Path) -> Path:
    """The path without links; a loop of links ends in a link again (pathlib's own raises)."""
    try:
        return Path(os.path.realpath(path))
    except (OSError, ValueError):  # this process's folder was removed; a NUL in the name
        return path
