"""What this process may use: cores, and memory, checked before work that would end badly."""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from styl3r_cli.errors import OutOfMemoryError

MEGABYTE = 1 << 20
# Threads a core that libraries start: numpy's BLAS, scipy's, and numba's or the network's.
THREADS = 4
# What a container may have, by the kernel's second and first kind of control groups.
CONTAINERS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")
MANY_THREADS = 500  # a core; nobody but a container's or a shell's limit is below


class Need(NamedTuple):
    """Bytes that a piece of work takes, as the two limits count them, and the machine.

    Attributes:
        addresses: as `ulimit -v` counts, several times the memory that is used: libraries, and
            what threads reserve, count in full.
        data: as `ulimit -d` counts: what of it can be written to.
        memory: what of it is used, and grows with the work. The rest is mostly reserved only.
    """

    addresses: int
    data: int
    memory: int = 0


def check(*needs: Need) -> None:
    """Refuse to start under a limit, or on a machine, that the work ahead cannot be done under.

    Libraries in C crash or wait for ever where they get less than they ask for, and a system whose
    memory is over ends processes, so that there would be nobody to tell it.

    Args:
        needs: what has to fit, each by itself.

    Raises:
        OutOfMemoryError: a limit is below one of them, or the machine's memory.
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
    there = memory()
    if there is not None and there < least.memory:
        raise OutOfMemoryError(
            f"out of memory: this machine or container has {there // MEGABYTE} MB, and "
            f"{least.memory // MEGABYTE} MB or more are needed; try a smaller --size"
        )


def check_threads() -> None:
    """Refuse to start where the threads of the libraries cannot.

    OpenBLAS then interrupts the process as Ctrl-C does, so that it ends as if a user had asked.
    A limit that leaves room for hundreds is not tried.

    Raises:
        OutOfMemoryError: the limit on a user's processes, which counts threads, is too low.
    """
    limit = _limit("RLIMIT_NPROC")
    if limit is None or limit >= MANY_THREADS * available_cores():
        return
    ended = threading.Event()
    threads = [threading.Thread(target=ended.wait) for _ in range(THREADS * available_cores())]
    started = []
    try:
        for thread in threads:
            thread.start()
            started.append(thread)
    except RuntimeError as error:
        raise OutOfMemoryError(
            f"out of threads: all processes of this user may have {limit} together, and this one "
            f"needs {len(threads)} more; raise the limit (ulimit -u)"
        ) from error
    finally:
        ended.set()
        for thread in started:
            thread.join()


def addresses() -> int | None:
    """Bytes of addresses that this process may use; None where nothing limits them."""
    return _limit("RLIMIT_AS")


def data() -> int | None:
    """Bytes of data that this process may use; None where nothing limits them."""
    return _limit("RLIMIT_DATA")


def memory() -> int | None:
    """Bytes of memory that there are for this process; None where the system does not say.

    That is the machine's, or what a container may use of it.
    """
    allowed = [limit for path in CONTAINERS if (limit := _number_in(path)) is not None]
    with suppress(AttributeError, ValueError, OSError):  # Windows has no such names
        allowed.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return min((limit for limit in allowed if limit > 0), default=None)


def _number_in(path: str) -> int | None:
    try:
        return int(Path(path).read_text("utf-8"))
    except (OSError, ValueError):  # there is none, or it says "max"
        return None


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
