"""Work in a few plain threads: which cores there are, and results in order."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

# More threads than any machine that this was tried on has cores for only wait for each other.
MOST_THREADS = 256

_pools: dict[tuple[int, int], ThreadPoolExecutor] = {}


def default_threads() -> int:
    """The cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return os.cpu_count() or 1


def count_threads(threads: int | None) -> int:
    """How many to use of those that were asked for; None for every core."""
    return min(default_threads() if threads is None else max(1, threads), MOST_THREADS)


def in_threads(work: Callable[[Any], Any], things: Sequence[Any], threads: int | None) -> list[Any]:
    """The results of ``work`` on each of a few things, in their order.

    Args:
        work: leaves the GIL to others, as kernels and numpy do, and starts no threads itself.
        things: what to do it with.
        threads: how many to use; None for every core.
    """
    threads = count_threads(threads)
    if len(things) <= 1 or threads == 1:
        return [work(thing) for thing in things]
    pool = _pool(threads)
    try:
        futures = [pool.submit(work, thing) for thing in things]
        return [future.result() for future in futures]
    except (KeyboardInterrupt, SystemExit):
        # It may have come while a thread was started, of which the pool does not know then: at
        # its exit Python would wait for that thread, and that thread for work.
        _pools.pop((os.getpid(), threads), None)
        pool.shutdown(wait=False, cancel_futures=True)
        raise


def _pool(threads: int) -> ThreadPoolExecutor:
    """This process's pool of that many threads (a forked child cannot use its parent's)."""
    key = (os.getpid(), threads)
    if key not in _pools:
        _pools[key] = ThreadPoolExecutor(threads, thread_name_prefix="styl3r")
    return _pools[key]
