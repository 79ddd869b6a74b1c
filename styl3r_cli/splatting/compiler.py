"""How the renderer's kernels are compiled, and how their work is spread over threads."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numba

# What LLVM may change in float arithmetic: fuse a*b+c (faster and more exact) and ignore the sign
# of zero. Neither reorders sums, so a picture is the same on every run and thread count.
EXACT_ENOUGH = {"contract", "nsz"}

# More parts than threads, because some bands of a frame hold many more splats than others.
PARTS_PER_THREAD = 4

_pools: dict[tuple[int, int], ThreadPoolExecutor] = {}


def kernel(function: Callable[..., Any], fastmath: set[str] | None = None) -> Callable[..., Any]:
    """Compile a function on its first call, without the GIL, and keep it on disk.

    numba looks for a writable folder when it decorates. With none (a read-only install and no
    home), it raises: then the function is compiled anew in each process, which costs seconds.

    Args:
        function: to compile; its arguments' types are those of the first call.
        fastmath: LLVM's licence with float arithmetic; by default EXACT_ENOUGH.
    """
    options: dict[str, Any] = {
        "nogil": True,
        "fastmath": EXACT_ENOUGH if fastmath is None else fastmath,
        "error_model": "numpy",  # x / 0 is inf, as in numpy, instead of an exception
    }
    try:
        compiled = numba.njit(cache=True, **options)(function)
        # numba checks the kept code against the function's own file; but the constants and the
        # other kernels that it compiled in come from the files beside it, and may have changed.
        kept = compiled._cache._cache_file
        kept._source_stamp = (kept._source_stamp, _sources(Path(function.__code__.co_filename)))
        return compiled
    except (RuntimeError, AttributeError, OSError):
        return numba.njit(**options)(function)


@cache
def _sources(file: Path) -> str:
    """Digest of the modules that a kernel in this file may draw on: its folder's and this one's."""
    folders = sorted({file.parent, Path(__file__).parent})
    digest = hashlib.sha256()
    for source in (source for folder in folders for source in sorted(folder.glob("*.py"))):
        digest.update(source.read_bytes())
    return digest.hexdigest()


def default_threads() -> int:
    """The cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return os.cpu_count() or 1


def parallel_for(
    compiled: Callable[..., Any],
    count: int,
    threads: int | None,
    *arguments: object,
    min_parts: int = 1,
) -> None:
    """Call ``compiled(begin, end, *arguments)`` over parts of ``range(count)``, in threads.

    Plain threads rather than numba's own: those cannot be entered from two threads at once, nor
    used after a fork, and both happen in a training's data loader.
    """
    threads = default_threads() if threads is None else max(1, threads)
    parts = min(count, max(min_parts, threads * PARTS_PER_THREAD if threads > 1 else 1))
    bounds = [count * part // max(parts, 1) for part in range(parts + 1)]
    calls = [(begin, end, *arguments) for begin, end in pairwise(bounds)]
    if threads == 1 or parts <= 1:
        for call in calls:
            compiled(*call)
        return
    futures = [_pool(threads).submit(compiled, *call) for call in calls]
    for future in futures:
        future.result()


def _pool(threads: int) -> ThreadPoolExecutor:
    """This process's pool of that many threads (a forked child cannot use its parent's)."""
    key = (os.getpid(), threads)
    if key not in _pools:
        _pools[key] = ThreadPoolExecutor(threads, thread_name_prefix="splatting")
    return _pools[key]
