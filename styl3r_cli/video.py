"""Videos as FFmpeg encodes them, written as the frames come: MP4, WebM and animated WebP."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.errors import OutputError, UsageError

if TYPE_CHECKING:
    import av


@dataclass(frozen=True)
class Codec:
    """How FFmpeg is to encode one kind of file.

    Attributes:
        container: FFmpeg's name of the file format.
        encoder: FFmpeg's name of the encoder.
        pixels: pixel format of pictures without and with alpha; empty where there is no alpha.
        options: of the encoder.
        container_options: of the file format.
    """

    container: str
    encoder: str
    pixels: tuple[str, str]
    options: dict[str, str]
    container_options: dict[str, str]


CODECS = {
    # x264's constant quality 18 is commonly taken as visually lossless (its default, 23, smears
    # the brush strokes of a stylized scene), and "veryfast" encodes faster than frames are drawn.
    # faststart moves the index to the front, so that a browser plays while it loads. Without mbtree
    # files are a tenth larger, but the same every time: its assembly reads memory that nobody has
    # written where frames are no multiple of 128 pixels wide.
    "mp4": Codec(
        "mp4",
        "libx264",
        ("yuv420p", ""),
        {"crf": "18", "preset": "veryfast", "mbtree": "0"},
        {"movflags": "+faststart"},
    ),
    # VP9's constant quality (its bit rate must be 0 for that); 24 of 63 looks as the above does.
    # cpu-used 4 is libvpx's compromise for offline work; bitexact leaves out a random identifier.
    "webm": Codec(
        "webm",
        "libvpx-vp9",
        ("yuv420p", "yuva420p"),
        {"crf": "24", "b": "0", "deadline": "good", "cpu-used": "4", "row-mt": "1"},
        {"fflags": "+bitexact"},
    ),
    # WebP's own quality scale, to 100; the file loops without end.
    "webp": Codec("webp", "libwebp_anim", ("bgra", "bgra"), {"quality": "85"}, {"loop": "0"}),
}

# Code points of ITU-T H.273 for BT.709, which is what players assume of HD: without the tags some
# take small videos for BT.601, and reds and greens shift.
BT709 = 1
LIMITED_RANGE = 1  # FFmpeg's AVCOL_RANGE_MPEG, 16 to 235

# Frame rates are stored as fractions; this denominator keeps 30000/1001 and the like exact.
LARGEST_DENOMINATOR = 100_000
# Far less than that denominator can say is no rate at all; a GIF's frames last 655 s at most.
SLOWEST = 0.01
# 29.97 is meant to be 30000/1001; so are 23.976 and 23.98.
NTSC_ROUNDING = 0.005

Picture = NDArray[np.uint8]


def write_video(
    path: Path, frames: Iterable[Picture], fps: float, kind: str = "mp4", name: str = ""
) -> int:
    """Write a video: MP4 that plays everywhere, WebM or animated WebP.

    MP4 is H.264, yuv420p, BT.709, faststart. Frames are encoded as they are produced, so a
    generator keeps memory small. A frame with an odd width or height is padded to even by
    repeating its last column or row where yuv420p requires that.

    Args:
        path: where to write, directly.
        frames: (H, W, 3) uint8 sRGB, or (H, W, 4) with straight alpha, all of one size.
        fps: frames per second.
        kind: one of CODECS.
        name: what messages call the file; by default the path.

    Returns:
        How many frames were written.

    Raises:
        UsageError: if there are no frames, the frame rate is not above 0, or the format has no
            alpha.
        OutputError: if the file cannot be written.
        ValueError: if a frame is not (H, W, 3 or 4) uint8 or has another size than the first.
    """
    import av

    codec, rate, name = CODECS[kind], frame_rate(fps), name or str(path)
    count = 0
    try:
        options = codec.container_options
        with av.open(str(path), "w", format=codec.container, options=options) as container:
            stream: Any = None
            shape: tuple[int, ...] = ()
            for picture in checked(frames):
                padded = _padded(picture) if "420" in codec.pixels[0] else picture
                if stream is None:
                    stream, shape = (
                        _open_stream(container, codec, rate, padded.shape),
                        picture.shape,
                    )
                if picture.shape != shape:
                    raise ValueError(f"frame {count} has another size than the first")
                container.mux(stream.encode(_to_frame(padded, stream.pix_fmt)))
                count += 1
            if stream is None:
                raise UsageError(f"{name}: a video needs at least one frame")
            container.mux(stream.encode(None))
    except av.FFmpegError as error:
        raise OutputError(f"cannot write {name}: {error.strerror or error}") from error
    return count


def frame_rate(fps: float) -> Fraction:
    """Frames per second as the fraction that is stored.

    Raises:
        UsageError: it is below SLOWEST, or no number.
    """
    if not SLOWEST <= fps < float("inf"):
        message = f"a video of {fps:g} frames per second cannot play"
        raise UsageError(f"{message}; give a rate of {SLOWEST:g} or more")
    rate = Fraction(fps).limit_denominator(LARGEST_DENOMINATOR)
    for ntsc in (Fraction(1000 * whole, 1001) for whole in (24, 30, 48, 60, 120)):
        if abs(fps - ntsc) < NTSC_ROUNDING:
            return ntsc
    return rate


def checked(frames: Iterable[Picture]) -> Iterable[Picture]:
    """The same frames, each looked at before it is encoded.

    Raises:
        ValueError: one is no picture.
    """
    for picture in frames:
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] not in (3, 4):
            raise ValueError(f"a frame is (H, W, 3) uint8, not {picture.shape} {picture.dtype}")
        yield picture


def _open_stream(
    container: av.container.OutputContainer, codec: Codec, rate: Fraction, shape: Any
) -> Any:
    pixels = codec.pixels[shape[2] == 4]
    if not pixels:
        raise UsageError(f"{codec.container} has no alpha; give a --background, or make a .webm")
    stream: Any = container.add_stream(codec.encoder, rate=rate, options=codec.options)
    stream.height, stream.width = shape[:2]
    stream.pix_fmt = pixels
    if pixels.startswith("yuv"):
        context = stream.codec_context
        context.colorspace = context.color_primaries = context.color_trc = BT709
        context.color_range = LIMITED_RANGE
    if pixels == "yuva420p":
        stream.metadata["ALPHA_MODE"] = "1"  # where WebM says that there is alpha
    return stream


def _to_frame(picture: Picture, pixels: str) -> av.VideoFrame:
    import av

    form = "rgba" if picture.shape[2] == 4 else "rgb24"
    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format=form)
    if not pixels.startswith("yuv"):
        return frame.reformat(format=pixels)
    frame = frame.reformat(
        format=pixels, dst_colorspace="ITU709", dst_color_range="MPEG", interpolation="BICUBIC"
    )
    frame.color_primaries = frame.color_trc = BT709
    return frame


def _padded(picture: Picture) -> Picture:
    """The picture with even sides, the last column and row repeated where needed."""
    height, width = picture.shape[:2]
    odd = ((0, height % 2), (0, width % 2), (0, 0))
    return np.ascontiguousarray(np.pad(picture, odd, mode="edge"))
