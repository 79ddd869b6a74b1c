"""How the renderer's kernels are compiled, and how their work is spread over threads."""

from __future__ import annotations

import gc
import hashlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from styl3r_cli.threads import count_threads, in_threads

# What LLVM may change in float arithmetic: fuse a*b+c (faster and more exact) and ignore the sign
# of zero. Neither reorders sums, so a picture is the same on every run and thread count.
EXACT_ENOUGH = {"contract", "nsz"}

# More parts than threads, because some bands of a frame hold many more splats than others.
PARTS_PER_THREAD = 4


def inlined(function: Callable[..., Any], fastmath: set[str] | None = None) -> Callable[..., Any]:
    """Compile a part of kernels: as they are, but not to be called from Python.

    Wrappers for Python's calls would take longer to compile than some of the parts themselves.
    """
    options = {**_options(fastmath), "no_cpython_wrapper": True}
    return numba.njit(**options)(function)


def merged(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a part that a kernel calls once: its lines become the kernel's own.

    LLVM then sees them once, instead of once by themselves and again in each caller. Where a part
    is called often, `inlined` is quicker: numba works through the lines at every call.
    """
    return numba.njit(**_options(None), inline="always")(function)


def _options(fastmath: set[str] | None) -> dict[str, Any]:
    return {
        "nogil": True,
        "no_cfunc_wrapper": True,  # nothing in C calls a kernel by its address
        "fastmath": EXACT_ENOUGH if fastmath is None else fastmath,
        "error_model": "numpy",  # x / 0 is inf, as in numpy, instead of an exception
    }


def kernel(function: Callable[..., Any], fastmath: set[str] | None = None) -> Callable[..., Any]:
    """Compile a function on its first call, without the GIL, and keep it on disk.

    numba looks for a writable folder when it decorates. With none (a read-only install and no
    home), it raises: then the function is compiled anew in each process, which costs seconds.

    Args:
        function: to compile; its arguments' types are those of the first call.
        fastmath: LLVM's licence with float arithmetic; by default EXACT_ENOUGH.
    """
    options = _options(fastmath)
    try:
        compiled = numba.njit(cache=True, **options)(function)
    except RuntimeError:
        compiled = numba.njit(**options)(function)
    compiled.compile = _uncollected(compiled.compile)
    with suppress(AttributeError, ImportError):  # no cache, or a numba that keeps code otherwise
        from styl3r_cli.splatting.kept_code import KeptCode

        kept = compiled._cache
        # numba checks the kept code against the function's own file; but the constants and the
        # other kernels that it compiled in come from the files beside it, and may have changed.
        stamp = (kept._cache_file._source_stamp, _sources(Path(function.__code__.co_filename)))
        kept._cache_file = KeptCode(kept.cache_path, kept._impl.filename_base, stamp)
        kept.load_overload = _or_nothing(kept.load_overload)
        kept.save_overload = _or_nothing(kept.save_overload)
    return compiled


def _uncollected(action: Callable[..., Any]) -> Callable[..., Any]:
    """The same action without garbage collections: they are a tenth of a compilation's time.

    numba makes millions of small objects, so Python keeps looking through all that it has.
    """

    def act(*arguments: Any, **options: Any) -> Any:
        if not gc.isenabled():  # so decided, or another thread compiles, and will set it back
            return action(*arguments, **options)
        gc.disable()
        try:
            return action(*arguments, **options)
        finally:
            gc.enable()

    return act


def _or_nothing(action: Callable[..., Any]) -> Callable[..., Any]:
    """The same action, for a cache: if it fails, there is none, and the code is compiled.

    A folder that became read-only, a full disk, or a file that was cut off: unpickling the last
    can raise anything.
    """

    def attempt(*arguments: Any, **options: Any) -> Any:
        try:
            return action(*arguments, **options)
        except Exception:
            return None

    return attempt


@cache
def _sources(file: Path) -> str:
    """Digest of the modules that a kernel in this file may draw on: its folder's and this one's."""
    folders = sorted({file.parent, Path(__file__).parent})
    digest = hashlib.sha256()
    for source in (source for folder in folders for source in sorted(folder.glob("*.py"))):
        digest.update(source.read_bytes())
    return digest.hexdigest()


def part_count(count: int, threads: int | None) -> int:
    """Into how many parts that many things are best cut."""
    threads = count_threads(threads)
    return min(max(count, 1), threads * PARTS_PER_THREAD if threads > 1 else 1)


def parallel_for(
    compiled: Callable[..., Any],
    count: int,
    threads: int | None,
    *arguments: object,
    costs: NDArray[np.integer] | None = None,
    scratch: Callable[[], tuple[NDArray[Any], ...]] = tuple,
) -> None:
    """Call ``compiled(begin, end, *arguments)`` over parts of ``range(count)``, in threads.

    Plain threads rather than numba's own: those cannot be entered from two threads at once, nor
    used after a fork, and both happen in a training's data loader.

    Args:
        compiled: a kernel.
        count: how many things there are.
        threads: how many to use; None for every core.
        arguments: the kernel's others.
        costs: (count + 1,) what the things before each cost together; alike, if not given.
        scratch: makes arrays for each call to work in, its last arguments. (Kernels that allocate
            memory themselves take longer to compile, by a tenth of a second for each type.)
    """
    parts = part_count(count, threads)
    bounds = np.arange(parts + 1) * count // parts
    if costs is not None:
        bounds[1:-1] = np.searchsorted(costs, costs[-1] * np.arange(1, parts) / parts)
    calls = [(b, e, *arguments, *scratch()) for b, e in pairwise(bounds.tolist()) if b < e]
    in_threads(lambda call: compiled(*call), calls, threads)
