"""Memory that ends: how to recognise it, whoever reports it."""

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
    "encoding error 1",  # libwebp's number for it, as Pillow passes it on
    "failed to allocate",
    "insufficient memory",
    "out of memory",
    "pthread_create failed",  # onnxruntime, of a thread that the system does not allow
    "not enough memory",  # Windows
    "paging file is too small",
    "can't start new thread",  # Python: there was no room for its stack
)
NOT_MEMORY = "static tls block"  # "cannot allocate memory in" it: a limit of the loader's


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
