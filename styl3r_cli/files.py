"""Results written beside their place and renamed when whole; binary pipes that fail politely."""

from __future__ import annotations

import errno
import io
import os
import secrets
import stat
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, cast

from styl3r_cli.errors import InputError, OutputError, UsageError
from styl3r_cli.incoming import ANYTHING, Kind, check_size, collected
from styl3r_cli.names import real_path
from styl3r_cli.pipes import first_bytes, opened_at_once, reader_of

TEMP_PREFIX = ".styl3r-"  # hidden, and short: the target's own name may already be 255 bytes long
STDOUT_CLOSED = "cannot write standard output: it is closed"
# OpenCV logs warnings and worse on standard error, and all else on standard output.
OPENCV_LOG, MOST_OPENCV_TELLS = "OPENCV_LOG_LEVEL", "WARNING"
OPENCV_TELLS_LESS = ("SILENT", "DISABLED", "OFF", "FATAL", "ERROR")
TEMP_MODE = 0o666  # what open() asks for, so that the user's umask decides as it always does

_unfinished: set[Path] = set()  # temporary files of this process


class ClosedOutput(io.TextIOBase):
    """Standard output where there is none: printing a result fails, instead of passing unnoticed.

    Python has None there, which `print` and click take for nothing to do.
    """

    def write(self, text: str) -> int:
        """Refuse any text.

        Raises:
            OutputError: always, unless there is nothing to write.
        """
        if text:
            raise OutputError(STDOUT_CLOSED)
        return 0


def stdout_is_closed() -> bool:
    """Whether this process was started without a standard output."""
    return sys.stdout is None or isinstance(sys.stdout, ClosedOutput)


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """A temporary name to write to, renamed to `path` when the block ends without an error.

    The temporary file lies in the same folder and has the same suffix, so that libraries which
    choose a format by suffix are right. On any failure, Ctrl-C included, it is removed and `path`
    is left as it was. A symbolic link keeps pointing where it points, an existing file keeps its
    permissions, and something that cannot be renamed over (/dev/null, a pipe) is written directly.

    Args:
        path: where the result belongs.

    Yields:
        The path to write to.

    Raises:
        OutputError: the folder is missing, or anything in the block raised OSError.
    """
    try:
        target = real_path(path)
        if _written_directly(target):
            with reader_of(target):
                yield target
            return
        temporary = _name_beside(target)
    except OSError as error:
        raise OutputError(_cannot_write(path, error)) from error
    try:
        _unfinished.add(temporary)
        _create(temporary, target)  # in here, as Ctrl-C may come as soon as it is there
        yield temporary
        _publish(temporary, target)
        _unfinished.discard(temporary)
    except BaseException as error:
        _remove(temporary)
        if isinstance(error, OSError):
            raise OutputError(_cannot_write(path, error)) from error
        raise


def remove_unfinished() -> None:
    """Remove what `atomic_write` has not published, in whichever thread: the process ends."""
    for temporary in tuple(_unfinished):
        _remove(temporary)


def keep_stdout_for_results() -> None:
    """Keep OpenCV's log off standard output, whatever the environment asks; before its import."""
    if os.environ.get(OPENCV_LOG, "OFF").upper() not in OPENCV_TELLS_LESS:
        os.environ[OPENCV_LOG] = MOST_OPENCV_TELLS


def write_stdout(data: bytes) -> None:
    """Write a binary result to standard output, for `-o -`.

    Raises:
        UsageError: standard output is a terminal, which binary data would garble.
        OutputError: the reading end has gone, or the device is full.
    """
    with stdout_stream() as write:
        write(data)


@contextmanager
def stdout_stream() -> Iterator[Callable[[bytes], None]]:
    """A function that writes binary data to standard output, for results that come in parts.

    Raises:
        UsageError: standard output is a terminal, which binary data would garble.
        OutputError: it is closed, the reading end has gone, or the device is full.
    """
    if stdout_is_closed():
        raise OutputError(STDOUT_CLOSED)
    if sys.stdout.isatty():
        raise UsageError(
            "-o -: standard output is a terminal; pipe it into a program or redirect it to a file"
        )

    def write(data: bytes) -> None:
        try:
            _write_all(sys.stdout.buffer, data)
            sys.stdout.buffer.flush()
        except BrokenPipeError as error:
            # The interpreter flushes stdout again at exit; give it somewhere harmless to do so.
            with suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            message = "-o -: the program that reads standard output closed it early"
            raise OutputError(message) from error
        except OSError as error:
            raise OutputError(_cannot_write("standard output", error)) from error

    yield write


def _write_all(stream: IO[bytes], data: bytes) -> None:
    """Until the last byte: with PYTHONUNBUFFERED=1 the stream is raw and may take a part only."""
    rest = memoryview(data)
    while rest:
        rest = rest[stream.write(rest) or 0 :]


def read_file(path: Path, kind: Kind = ANYTHING) -> bytes:
    """What is in a file, or comes through a pipe that has a name: mkfifo's, or a shell's `<(...)`.

    Args:
        path: the file.
        kind: how large it may be, and how it has to begin where it comes through a pipe.

    Raises:
        InputError: it is larger than its kind, or through the pipe comes something else.
        MemoryError: it does not fit.
        OSError: it cannot be read; it is a pipe that nobody writes to for long, or something of
            the system's that has nothing to say yet; or it is a device: /dev/zero never ends, and
            a link may lead there.
    """
    with open(path, "rb", opener=opened_at_once) as file:
        status = os.fstat(file.fileno())
        mode = status.st_mode
        if stat.S_ISCHR(mode) or stat.S_ISBLK(mode):
            raise OSError(errno.EINVAL, "a device, not a file", str(path))
        if stat.S_ISFIFO(mode):
            return collected(str(path), file.read1, kind, first_bytes(file.fileno()))
        check_size(str(path), status.st_size, kind)
        data = file.read()
        if data is None:  # /proc/kmsg, say
            raise BlockingIOError(errno.EAGAIN, "nothing to be read", str(path))
        return data


def read_stdin(kind: Kind = ANYTHING) -> bytes:
    """Everything that is piped in, for an input named `-`.

    Args:
        kind: how large it may be, and how it has to begin.

    Raises:
        UsageError: standard input is a terminal.
        InputError: nothing came, which means that the program before the pipe failed; or
            something other than what was expected.
    """
    if sys.stdin is None:
        raise UsageError("-: standard input is closed; pipe a file into it or name a file")
    if sys.stdin.isatty():
        raise UsageError("-: standard input is a terminal; pipe a file into it or name a file")
    try:
        data = collected("-", cast(io.BufferedReader, sys.stdin.buffer).read1, kind)
    except OSError as error:
        raise InputError(f"-: cannot read standard input: {error.strerror or error}") from error
    if not data:
        raise InputError("-: standard input is empty; did the program before the pipe fail?")
    return data


def _written_directly(target: Path) -> bool:
    """Whether the target exists and is neither a file nor a folder: a device or a pipe."""
    try:
        mode = target.stat().st_mode
    except FileNotFoundError:
        return False
    if stat.S_ISDIR(mode):
        raise OutputError(f"cannot write {target}: it is a folder; name a file in it")
    return not stat.S_ISREG(mode)


def _name_beside(target: Path) -> Path:
    if not target.parent.is_dir():
        raise OutputError(f"cannot write {target}: the folder {target.parent} does not exist")
    if target.exists() and not os.access(target, os.W_OK):
        raise OutputError(f"cannot write {target}: the file is write-protected")
    return target.with_name(f"{TEMP_PREFIX}{secrets.token_hex(6)}{target.suffix}")


def _create(temporary: Path, target: Path) -> None:
    os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, TEMP_MODE))
    if target.exists():
        temporary.chmod(stat.S_IMODE(target.stat().st_mode))


def _publish(temporary: Path, target: Path) -> None:
    with temporary.open("rb+") as file:
        os.fsync(file.fileno())  # renaming first could leave an empty file after a power cut
    temporary.replace(target)


def _remove(temporary: Path) -> None:
    with suppress(OSError):
        temporary.unlink()
    _unfinished.discard(temporary)


def _cannot_write(what: Path | str, error: OSError) -> str:
    return f"cannot write {what}: {error.strerror or error}"
