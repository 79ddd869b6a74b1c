"""Videos that play anywhere: H.264 in MP4, written as the frames come."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.errors import OutputError, UsageError
from styl3r_cli.files import atomic_write

if TYPE_CHECKING:
    import av

# x264's constant quality; 18 is commonly taken as visually lossless (its default, 23, smears the
# brush strokes of a stylized scene).
QUALITY = 18

# What x264's "preset" trades: "veryfast" encodes faster than frames are rendered.
PRESET = "veryfast"

# Code points of ITU-T H.273 for BT.709, which is what players assume of HD: without the tags some
# take small videos for BT.601, and reds and greens shift.
BT709 = 1
LIMITED_RANGE = 1  # FFmpeg's AVCOL_RANGE_MPEG, 16 to 235

# Frame rates are stored as fractions; this denominator keeps 30000/1001 and the like exact.
LARGEST_DENOMINATOR = 100_000

Picture = NDArray[np.uint8]


def write_video(
    destination: str | os.PathLike[str] | IO[bytes], frames: Iterable[Picture], fps: float
) -> int:
    """Write an MP4 that browsers, phones and editors play (H.264, yuv420p, BT.709, faststart).

    Frames are encoded as they are produced, so a generator keeps memory small. A frame with an odd
    width or height is padded to even by repeating its last column or row, as yuv420p requires.
    A file appears under its name only when it is whole.

    Args:
        destination: a path, or a binary file object (a pipe will do), which gets all at the end.
        frames: (H, W, 3) uint8 sRGB, all of one size.
        fps: frames per second.

    Returns:
        How many frames were written.

    Raises:
        UsageError: if there are no frames or the frame rate is not above 0.
        OutputError: if the file cannot be written.
        ValueError: if a frame is not (H, W, 3) uint8 or has another size than the first.
    """
    if not 0 < fps < float("inf"):
        raise UsageError(f"a video of {fps} frames per second cannot play; give a rate above 0")
    rate = Fraction(fps).limit_denominator(LARGEST_DENOMINATOR)
    if isinstance(destination, (str, os.PathLike)):
        with atomic_write(Path(destination)) as temporary:
            return _encode(temporary, frames, rate, str(destination))
    # Moving the index to the front needs a file that FFmpeg can open a second time.
    with TemporaryDirectory(prefix="styl3r-") as folder:
        path = Path(folder) / "video.mp4"
        count = _encode(path, frames, rate, "the video")
        with path.open("rb") as file:
            shutil.copyfileobj(file, destination)
    return count


def _encode(path: Path, frames: Iterable[Picture], rate: Fraction, name: str) -> int:
    import av

    count = 0
    try:
        # faststart moves the index to the front, so that a browser plays while it loads.
        options = {"movflags": "+faststart"}
        with av.open(str(path), "w", format="mp4", options=options) as container:
            stream: Any = None
            shape: tuple[int, ...] = ()
            for picture in frames:
                padded = _padded(_checked(picture))
                if stream is None:
                    stream, shape = _open_stream(container, rate, padded.shape), picture.shape
                if picture.shape != shape:
                    raise ValueError(f"frame {count} has another size than the first")
                container.mux(stream.encode(_to_yuv(padded)))
                count += 1
            if stream is None:
                raise UsageError(f"{name}: a video needs at least one frame")
            container.mux(stream.encode(None))
    except av.FFmpegError as error:
        raise OutputError(f"cannot write {name}: {error.strerror or error}") from error
    return count


def _open_stream(container: av.container.OutputContainer, rate: Fraction, shape: Any) -> Any:
    options = {"crf": str(QUALITY), "preset": PRESET}
    stream: Any = container.add_stream("libx264", rate=rate, options=options)
    stream.height, stream.width = shape[:2]
    stream.pix_fmt = "yuv420p"
    context = stream.codec_context
    context.colorspace = context.color_primaries = context.color_trc = BT709
    context.color_range = LIMITED_RANGE
    return stream


def _to_yuv(picture: Picture) -> av.VideoFrame:
    import av

    frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
    frame = frame.reformat(
        format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG", interpolation="BICUBIC"
    )
    frame.color_primaries = frame.color_trc = BT709
    return frame


def _checked(picture: Picture) -> Picture:
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
        raise ValueError(f"a frame is (H, W, 3) uint8, not {picture.shape} {picture.dtype}")
    return picture


def _padded(picture: Picture) -> Picture:
    """The picture with even sides, the last column and row repeated where needed."""
    height, width = picture.shape[:2]
    odd = ((0, height % 2), (0, width % 2), (0, 0))
    return np.ascontiguousarray(np.pad(picture, odd, mode="edge"))
