"""Limits on a process's memory, for the tests that start one under them."""

from __future__ import annotations

from collections.abc import Callable

KINDS = {"addresses": "RLIMIT_AS", "data": "RLIMIT_DATA"}  # as ulimit -v and -d set them


def limited(kind: str, size: int) -> Callable[[], None]:
    """What a process does before it starts, to have no more than so many bytes."""
    import resource

    return lambda: resource.setrlimit(getattr(resource, KINDS[kind]), (size, size))


def one_line(err: str) -> bool:
    """Whether it is an error as users should see them."""
    return err.startswith("styl3r: error: ") and err.count("\n") == 1 and "a bug" not in err
