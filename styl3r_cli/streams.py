"""Video for the next program in a pipe: y4m, raw RGB and PNG, a frame at a time."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable
from fractions import Fraction

import numpy as np

from styl3r_cli.errors import UsageError
from styl3r_cli.frames import Picture
from styl3r_cli.video import checked, frame_rate

Write = Callable[[bytes], object]
# y4m cannot say which matrix its colours have. Players take small pictures for BT.601 and others
# for BT.709, by about this rule (mpv's), so that is what they get.
HD_WIDTH, HD_HEIGHT = 1280, 576


def write_y4m(write: Write, frames: Iterable[Picture], fps: float) -> int:
    """YUV4MPEG2, which says its own size and rate: for ffmpeg, mpv and encoders.

    Full colour resolution (C444), limited range; BT.709 for HD and BT.601 below.

    Args:
        write: takes the bytes in order.
        frames: (H, W, 3) uint8 sRGB, all of one size.
        fps: frames per second.

    Returns:
        How many frames were written.

    Raises:
        UsageError: if frames have alpha, or the frame rate is not above 0.
    """
    import av

    count, rate = 0, frame_rate(fps)
    for picture in checked(frames):
        if picture.shape[2] == 4:
            raise UsageError("y4m has no alpha; give a --background, or use --format rgb")
        height, width = picture.shape[:2]
        if count == 0:
            write(_header(width, height, rate))
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        matrix = "ITU709" if width >= HD_WIDTH or height > HD_HEIGHT else "ITU601"
        planes = frame.reformat(format="yuv444p", dst_colorspace=matrix, dst_color_range="MPEG")
        write(b"FRAME\n" + planes.to_ndarray().tobytes())
        count += 1
    return count


def _header(width: int, height: int, rate: Fraction) -> bytes:
    timing = f"F{rate.numerator}:{rate.denominator}"
    return f"YUV4MPEG2 W{width} H{height} {timing} Ip A1:1 C444 XCOLORRANGE=LIMITED\n".encode()


def write_raw(write: Write, frames: Iterable[Picture], _fps: float) -> int:
    """The pixels and nothing else, row by row: RGB, or RGBA where there is alpha."""
    count = 0
    for picture in checked(frames):
        write(picture.tobytes())
        count += 1
    return count


def write_png_stream(write: Write, frames: Iterable[Picture], _fps: float) -> int:
    """PNG files one after the other, for `ffmpeg -f image2pipe` and its like."""
    from PIL import Image

    count = 0
    for picture in checked(frames):
        whole = io.BytesIO()
        Image.fromarray(picture).save(whole, format="PNG")
        write(whole.getvalue())
        count += 1
    return count


STREAMS = {"y4m": write_y4m, "rgb": write_raw, "png": write_png_stream}
