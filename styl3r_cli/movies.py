"""Moving pictures in any format, into a file or through a pipe."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from styl3r_cli.errors import OutputError
from styl3r_cli.files import atomic_write, stdout_stream
from styl3r_cli.frames import Picture
from styl3r_cli.pipes import is_pipe

FILES = ("mp4", "webm", "gif", "webp")  # need a place where they can seek
PIPED = ("y4m", "rgb", "png")  # can go out frame by frame
BLOCK = 1 << 20  # bytes copied into a pipe at a time


def write_movie(destination: Path | None, frames: Iterable[Picture], fps: float, kind: str) -> int:
    """Write a video; memory does not grow with the number of frames.

    Args:
        destination: a file, which appears when it is whole, a named pipe, or None for standard
            output.
        frames: (H, W, 3) uint8 sRGB, or (H, W, 4) with straight alpha, all of one size.
        fps: frames per second.
        kind: one of FILES or PIPED.

    Returns:
        How many frames were written.

    Raises:
        UsageError: if there are no frames, or the format cannot hold them.
        OutputError: if they cannot be written.
    """
    if kind in PIPED:
        return _write_stream(destination, frames, fps, kind)
    if destination is not None and not is_pipe(destination):
        with atomic_write(destination) as temporary:
            return _write_file(temporary, frames, fps, kind, str(destination))
    with _stream(destination) as write, ExitStack() as stack:
        try:
            folder = stack.enter_context(TemporaryDirectory(prefix="styl3r-"))
            path = Path(folder) / f"video.{kind}"
            count = _write_file(path, frames, fps, kind, "the video")
        except OSError as error:
            reason = error.strerror or error
            raise OutputError(
                f"cannot write the video: {reason} (it is whole in a folder before it goes "
                "through a pipe; TMPDIR names another)"
            ) from error
        with path.open("rb") as file:
            while block := file.read(BLOCK):
                write(block)
    return count


def _write_file(path: Path, frames: Iterable[Picture], fps: float, kind: str, name: str) -> int:
    if kind == "gif":
        from styl3r_cli.gif import write_gif

        return write_gif(path, frames, fps, name)
    from styl3r_cli.video import write_video

    return write_video(path, frames, fps, kind, name)


def _write_stream(
    destination: Path | None, frames: Iterable[Picture], fps: float, kind: str
) -> int:
    from styl3r_cli.streams import STREAMS

    with _stream(destination) as write:
        return STREAMS[kind](write, frames, fps)


@contextmanager
def _stream(destination: Path | None) -> Iterator[Callable[[bytes], object]]:
    """A function that writes to a file, a named pipe or, for None, to standard output."""
    if destination is None:
        with stdout_stream() as write:
            yield write
    else:
        with atomic_write(destination) as temporary, temporary.open("wb") as file:
            yield file.write
