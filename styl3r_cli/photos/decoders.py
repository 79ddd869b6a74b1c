"""Which of Pillow's decoders may open a photo, and what they say of one that none of them takes."""

from __future__ import annotations

import io
from pathlib import Path

from PIL import (  # the plugins register their formats on import
    AvifImagePlugin,  # noqa: F401
    BmpImagePlugin,  # noqa: F401
    GifImagePlugin,  # noqa: F401
    Image,
    JpegImagePlugin,  # noqa: F401
    PngImagePlugin,  # noqa: F401
    PpmImagePlugin,  # noqa: F401
    TiffImagePlugin,  # noqa: F401
    UnidentifiedImageError,
    WebPImagePlugin,  # noqa: F401
)

from styl3r_cli.errors import InputError

# Formats that hold photos; Pillow's others include ones that start external programs (EPS).
FORMATS = ["JPEG", "PNG", "WEBP", "TIFF", "BMP", "GIF", "PPM", "AVIF", "HEIF"]
LOOKED_AT = 16  # bytes of a file, by which Pillow's plugins tell their format

UNKNOWN = "not a picture that can be read (JPEG, PNG, WebP, TIFF)"


def begins(begun: bytes, path: Path) -> bool:
    """Whether the first 16 bytes or more of a file may be those of a picture.

    Raises:
        InputError: they are of something else.
    """
    accepts = [Image.OPEN[name][1] for name in FORMATS if name in Image.OPEN]
    boxes = begun[4:8] == b"ftyp"  # HEIC, whose plugin is not there before it is needed
    if not boxes and not any(accept and accept(begun[:LOOKED_AT]) for accept in accepts):
        raise InputError(f"{path}: {UNKNOWN}")
    return True


def identified(path: Path, data: bytes) -> Image.Image:
    """A photo file's picture, not yet decoded.

    Raises:
        InputError: it is none of FORMATS; HEIF is one where its plugin is registered.
    """
    formats = [name for name in FORMATS if name in Image.OPEN]
    try:
        return Image.open(io.BytesIO(data), formats=formats)
    except UnidentifiedImageError as error:
        # Of pixels of a kind that it does not know, Pillow says no more than of noise.
        accepts = ((name, Image.OPEN[name][1]) for name in formats)
        likely = [name for name, accept in accepts if accept and accept(data[:LOOKED_AT]) is True]
        message = UNKNOWN
        if likely:
            message = f"{likely[0]}, but damaged or with pixels of a kind that cannot be read"
            message += "; export it as PNG with 8 or 16 bits"
        raise InputError(f"{path}: {message}") from error
