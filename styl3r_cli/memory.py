"""Memory that ends: how to recognise it, whoever reports it, and a check before the start."""

from __future__ import annotations

import errno

from styl3r_cli.errors import OutOfMemoryError

# How libraries in C, loaders and Windows say it, in exceptions that are no MemoryError.
PHRASES = (
    "failed to map segment",  # glibc, of a library that does not fit
    "cannot allocate memory",
    "cannot create shared object descriptor",
    "bad_alloc",  # C++, as onnxruntime and OpenCV pass it on
    "bad allocation",
    "failed to allocate",
    "insufficient memory",
    "out of memory",
    "pthread_create failed",  # onnxruntime, of a thread that the system does not allow
    "not enough memory",  # Windows
    "paging file is too small",
    "can't start new thread",  # Python: there was no room for its stack
)
NOT_MEMORY = "static tls block"  # "cannot allocate memory in" it: a limit of the loader's
# Bytes of address space, which is several times the memory that is used: libraries and the stacks
# of threads count in full. All were measured on two cores; under less, libraries in C crash or
# wait for ever. Three views of 64x64 and their cameras take 1.1 GB, a frame of 64x64 0.69 GB;
# under 0.16 GB numpy does not load, and its own lines on that end in a signal as of Ctrl-C.
LEAST_AT_ALL = 200 << 20
LEAST_FOR_NETWORK = 1200 << 20
LEAST_TO_DRAW = 700 << 20
MEGABYTE = 1 << 20


def ended(error: BaseException | None) -> bool:
    """Whether an exception, or one that led to it, says that there is no more memory."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        if isinstance(error, (MemoryError, OutOfMemoryError)) or _says_so(error):
            return True
        seen.add(id(error))
        error = error.__cause__ or error.__context__
    return False


def _says_so(error: BaseException) -> bool:
    if isinstance(error, OSError) and error.errno == errno.ENOMEM:
        return True
    text = str(error).lower()
    return NOT_MEMORY not in text and any(phrase in text for phrase in PHRASES)


def check_limit(least: int) -> None:
    """Refuse to start under a limit (`ulimit -v`) that the work ahead cannot be done under.

    Raises:
        OutOfMemoryError: the limit is below `least`, one of the constants above.
    """
    limit = address_space()
    if limit is not None and limit < least:
        raise OutOfMemoryError(
            f"out of memory: this process may use {limit // MEGABYTE} MB of addresses, and needs "
            f"{least // MEGABYTE} MB or more; raise the limit (ulimit -v unlimited)"
        )


def address_space() -> int | None:
    """Bytes of addresses that this process may use; None where nothing limits them."""
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return None
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return None if limit == resource.RLIM_INFINITY else limit
