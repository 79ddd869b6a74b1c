"""What is read into memory whole: how large it may be, and where its first bytes refuse it."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from dataclasses import dataclass

from styl3r_cli import limits
from styl3r_cli.errors import InputError
from styl3r_cli.limits import MEGABYTE

BLOCK = 1 << 20  # bytes that are asked of a pipe at once
LEAST_TOLD = 16  # bytes by which most formats can be told


@dataclass(frozen=True)
class Kind:
    """What somebody expects to read.

    Attributes:
        what: what messages call it.
        most: bytes that it may have; None for what the memory can hold.
        begins: whether what came so far is the beginning of one: False for not known yet, and
            an InputError for no. It is asked again whenever twice as much is there.
    """

    what: str = "a file"
    most: int | None = None
    begins: Callable[[bytes], bool] = lambda _: True


ANYTHING = Kind()


def check_size(name: str, size: int, kind: Kind) -> None:
    """Refuse a file before it is read.

    Raises:
        InputError: it is larger than any of its kind.
        MemoryError: it is larger than the memory.
    """
    if kind.most is not None and size > kind.most:
        raise InputError(f"{name}: {_too_large(kind)}")
    memory = limits.memory()
    if memory is not None and size > memory:
        raise MemoryError


def collected(name: str, read: Callable[[int], bytes], kind: Kind, begun: bytes = b"") -> bytes:
    """All that comes through a pipe, which may have no end.

    Args:
        name: what to call it in messages.
        read: gives at most so many bytes, and none at the end.
        kind: what it has to be.
        begun: what was read before.

    Raises:
        InputError: its first bytes are of something else, or there are too many.
    """
    whole = io.BytesIO()  # whose bytes can be had without a copy
    whole.write(begun)
    memory = limits.memory()
    # Nothing can be done with what leaves no room beside it.
    room = sys.maxsize if memory is None else memory // 2
    known, asked_at = False, LEAST_TOLD
    while True:
        size = whole.tell()
        if kind.most is not None and size > kind.most:
            raise InputError(f"{name}: {_too_large(kind)}")
        if size > room:
            raise InputError(
                f"{name}: larger than {room // MEGABYTE} MB, half of this machine's memory; "
                "does what comes through the pipe have an end?"
            )
        if not known and size >= asked_at:
            known, asked_at = kind.begins(whole.getvalue()), 2 * size
        block = read(BLOCK)
        if not block:
            return whole.getvalue()
        whole.write(block)


def _too_large(kind: Kind) -> str:
    most = (kind.most or 0) // MEGABYTE
    return f"larger than {most} MB, the most that is read of {kind.what}"
