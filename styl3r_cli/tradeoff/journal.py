"""What was measured, a line each, with digests: a run that goes on takes what is as it was."""

from __future__ import annotations

import errno
import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from styl3r_cli.errors import OutputError
from styl3r_cli.files import atomic_write, read_file

Entry = dict[str, Any]
BUSY = (errno.EWOULDBLOCK, errno.EACCES)  # what a lock that another process has fails with


class Journal:
    """A file of lines, each of which says by its digest whether it is as it was written."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self) -> list[Entry]:
        """What the lines say, up to the first that is cut short or was changed."""
        try:
            data = read_file(self.path)
        except OSError:
            return []
        entries = []
        for line in data.splitlines():
            try:
                stored = json.loads(line)
                if stored["sha256"] != _digest(stored["entry"]):
                    break
            except (ValueError, LookupError, TypeError):
                break
            entries.append(stored["entry"])
        return entries

    def write(self, entries: Sequence[Entry]) -> None:
        """Have these in it, and nothing else: a line that was cut short would spoil the next one.

        Raises:
            OutputError: it cannot be written.
        """
        with atomic_write(self.path) as temporary:
            temporary.write_text("".join(map(_line, entries)), encoding="utf-8")

    def add(self, entry: Entry) -> None:
        """Write one more.

        Raises:
            OutputError: it cannot be written.
        """
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(_line(entry))
        except OSError as error:
            raise OutputError(f"cannot write {self.path}: {error.strerror or error}") from error


def digest_of(path: Path) -> str | None:
    """A file's SHA-256; None where it cannot be read."""
    try:
        return hashlib.sha256(read_file(path)).hexdigest()
    except OSError:
        return None


def _digest(entry: Entry) -> str:
    return hashlib.sha256(json.dumps(entry, sort_keys=True).encode()).hexdigest()


def _line(entry: Entry) -> str:
    return json.dumps({"sha256": _digest(entry), "entry": entry}) + "\n"


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Keep a second run out of a folder, where the system and the disk have locks.

    The system takes the lock back however the process ends.

    Raises:
        OutputError: another process is in it.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        yield
        return
    held = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # a disk without locks
            try:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                if error.errno in BUSY:
                    message = f"cannot write {folder}: another styl3r tradeoff is at work in it"
                    raise OutputError(message) from error
                raise
        yield
    finally:
        os.close(held)
