"""Animated GIFs, written as the frames come."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from styl3r_cli.errors import UsageError
from styl3r_cli.frames import Picture
from styl3r_cli.video import checked, frame_rate

COLOURS = 256  # what a GIF's palette holds
# Browsers play frames that last less than 2 hundredths of a second at a tenth of their speed.
FASTEST = 50.0
# An application extension, as Netscape introduced it: repeat without end.
LOOP_FOREVER = b"!\xff\x0bNETSCAPE2.0\x03\x01\x00\x00\x00"
TRAILER = b";"
# Fixed places in a file of one picture (GIF89a specification): its head, the head's flags, and
# after the palette an extension, which says how long the picture lasts, and its descriptor.
HEAD, HEAD_FLAGS = 13, 10
EXTENSION, DESCRIPTOR = 8, 10
LOCAL_TABLE, TABLE_SIZE = 0x80, 0x07  # flags: a palette of its own follows; its size


def write_gif(path: Path, frames: Iterable[Picture], fps: float, name: str = "") -> int:
    """Write an endlessly looping GIF; each frame has a palette of its own.

    A GIF counts hundredths of a second: frames last a whole number of them, in turn shorter and
    longer so that the whole keeps its time.

    Args:
        path: where to write, directly.
        frames: (H, W, 3) uint8 sRGB, all of one size.
        fps: frames per second, at most 50.
        name: what messages call the file; by default the path.

    Returns:
        How many frames were written.

    Raises:
        UsageError: if there are no frames, they have alpha, or the rate is too high.
        ValueError: if a frame is no picture.
    """
    rate, name = float(frame_rate(fps)), name or str(path)
    if rate > FASTEST:
        raise UsageError(f"{name}: a GIF plays at most {FASTEST:g} frames per second (--fps)")
    count = 0
    with path.open("wb") as file:
        for picture in checked(frames):
            if picture.shape[2] == 4:
                raise UsageError(f"{name}: a GIF has no soft alpha; give a --background")
            lasts = round(100 * (count + 1) / rate) - round(100 * count / rate)
            head, block = _frame(picture, lasts)
            file.write(block if count else head + LOOP_FOREVER + block)
            count += 1
        file.write(TRAILER)
    if count == 0:
        raise UsageError(f"{name}: a video needs at least one frame")
    return count


def _frame(picture: Picture, lasts: int) -> tuple[bytes, bytes]:
    """The head of a file without a palette, and a frame with one of its own.

    Pillow writes whole animations only when it has all frames; so each is written as a file, and
    its palette moved to where it serves this frame alone.
    """
    from PIL import Image

    file = io.BytesIO()
    image = Image.fromarray(np.ascontiguousarray(picture)).quantize(COLOURS)
    image.save(file, format="GIF", duration=10 * lasts, optimize=False)
    data = file.getvalue()
    size = data[HEAD_FLAGS] & TABLE_SIZE
    start = HEAD + 3 * 2 ** (size + 1)
    palette, rest = data[HEAD:start], data[start:-1]
    head = bytearray(data[:HEAD])
    head[HEAD_FLAGS] &= ~(LOCAL_TABLE | TABLE_SIZE) & 0xFF
    split = EXTENSION + DESCRIPTOR
    block = bytearray(rest[:split])
    block[-1] |= LOCAL_TABLE | size
    return bytes(head), bytes(block) + palette + rest[split:]
