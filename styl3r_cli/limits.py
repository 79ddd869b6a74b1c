"""What this process may use: cores, and memory, checked before work that would end badly."""

from __future__ import annotations

import os
from typing import NamedTuple

from styl3r_cli.errors import OutOfMemoryError

MEGABYTE = 1 << 20


class Need(NamedTuple):
    """Bytes that a piece of work takes, as the two limits count them.

    Attributes:
        addresses: as `ulimit -v` counts, several times the memory that is used: libraries, and
            what threads reserve, count in full.
        data: as `ulimit -d` counts: what of it can be written to.
    """

    addresses: int
    data: int


def check(*needs: Need) -> None:
    """Refuse to start under a limit that the work ahead cannot be done under.

    Libraries in C crash or wait for ever where they get less than they ask for, so that there
    would be nobody to tell it.

    Args:
        needs: what has to fit, each by itself.

    Raises:
        OutOfMemoryError: a limit is below one of them.
    """
    least = Need(*map(max, zip(*needs, strict=True)))
    limited = (
        (addresses(), least.addresses, "of addresses", "-v"),
        (data(), least.data, "of data", "-d"),
    )
    for limit, need, what, option in limited:
        if limit is not None and limit < need:
            raise OutOfMemoryError(
                f"out of memory: this process may use {limit // MEGABYTE} MB {what}, and needs "
                f"{need // MEGABYTE} MB or more; raise the limit (ulimit {option} unlimited)"
            )


def addresses() -> int | None:
    """Bytes of addresses that this process may use; None where nothing limits them."""
    return _limit("RLIMIT_AS")


def data() -> int | None:
    """Bytes of data that this process may use; None where nothing limits them."""
    return _limit("RLIMIT_DATA")


def _limit(name: str) -> int | None:
    try:
        import resource
    except ImportError:  # Windows has no such limits
        return None
    limit = resource.getrlimit(getattr(resource, name))[0]
    return None if limit == resource.RLIM_INFINITY else limit


def available_cores() -> int:
    """Cores that this process may run on (containers and taskset allow fewer than there are)."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
