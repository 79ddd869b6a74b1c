"""Pipes that have names, in a folder or from a shell: waiting for their other end, not for ever."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# Seconds that somebody has to open a named pipe's other end (a program before this one in a script
# may have work to do first), and between two looks whether they have.
PATIENCE, GLANCE = 60.0, 0.02
PIPE_SIZE = 1 << 16  # bytes


def is_pipe(path: Path) -> bool:
    """Whether the path names a pipe, which can be read only once."""
    try:
        return path.is_fifo()
    except OSError:
        return False


def opened_at_once(name: str, flags: int) -> int:
    """Open a file without waiting for somebody at a pipe's other end."""
    return os.open(name, flags | getattr(os, "O_NONBLOCK", 0))


def first_bytes(pipe: int) -> bytes:
    """Wait for whoever writes into a pipe, and no longer than `PATIENCE` for there to be anybody.

    Without a writer, a pipe that does not block is at its end; with one that is still to write,
    there is nothing to be read yet.
    """
    until = time.monotonic() + PATIENCE
    begun = b""
    while not begun:
        try:
            begun = os.read(pipe, PIPE_SIZE)
        except BlockingIOError:
            break
        if not begun:
            if time.monotonic() > until:
                raise TimeoutError(errno.ETIMEDOUT, "a pipe that nobody writes to")
            time.sleep(GLANCE)
    os.set_blocking(pipe, True)
    return begun


@contextmanager
def reader_of(target: Path) -> Iterator[None]:
    """Wait for whoever reads from a named pipe; it is open meanwhile, or they would see its end.

    Raises:
        OSError: nobody has for `PATIENCE`.
    """
    if not is_pipe(target):
        yield
        return
    until = time.monotonic() + PATIENCE
    while True:
        try:
            pipe = os.open(target, os.O_WRONLY | os.O_NONBLOCK)
            break
        except OSError as error:
            if error.errno != errno.ENXIO:
                raise
        if time.monotonic() > until:
            raise TimeoutError(errno.ETIMEDOUT, "a pipe that nobody reads from")
        time.sleep(GLANCE)
    try:
        yield
    finally:
        os.close(pipe)
