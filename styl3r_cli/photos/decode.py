"""One photo file to upright 8-bit sRGB, whatever its format, depth, colour space or rotation."""

from __future__ import annotations

import io
import logging
import struct
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageCms

from styl3r_cli import memory
from styl3r_cli.errors import InputError, shortened
from styl3r_cli.files import read_file
from styl3r_cli.incoming import Kind
from styl3r_cli.photos.decoders import begins, identified
from styl3r_cli.photos.focal import read_equivalent_focal

# A 200-megapixel phone photo passes; more is a scan too large for this, or a decompression bomb.
MAX_PIXELS = 220_000_000
# Bytes of a file: so many pixels of four channels and 16 bits as they are, and what is beside them.
LARGEST_FILE = 8 * MAX_PIXELS + (64 << 20)
# Photos have at most ten pixels a byte, flat drawings some dozens. What claims more, and would take
# much memory, is a decompression bomb.
BELIEVED_PIXELS, MOST_PIXELS_A_BYTE = 32_000_000, 100
HEIC_BRANDS = {b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1"}
RAW_SUFFIXES = {".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw"}
WHITE = (255, 255, 255)  # what transparent pixels are put on: paper, as picture viewers print them
MAX_8_BIT, MAX_16_BIT = 255, 65535
ORIENTATION = 0x0112  # EXIF tag
BITS_PER_SAMPLE, PHOTOMETRIC_INTERPRETATION, WHITE_IS_ZERO = 258, 262, 0  # of TIFF
UPRIGHT = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}
# What Pillow logs about damaged files would come between the lines on a user's screen.
logging.getLogger("PIL").addHandler(logging.NullHandler())
DECODER_FAILURES = (
    OSError,
    ValueError,
    SyntaxError,  # Pillow's PNG reader
    EOFError,
    IndexError,
    KeyError,
    TypeError,
    RuntimeError,  # libheif
    struct.error,
    zlib.error,
    Image.DecompressionBombError,
)


@dataclass(frozen=True)
class Decoded:
    """A photo as a viewer shows it.

    Attributes:
        image: RGB, 8 bits, sRGB, upright.
        equivalent_focal: 35 mm equivalent focal length from EXIF in mm, None where unknown.
        notes: what was done to the pixels that a user may want to know.
    """

    image: Image.Image
    equivalent_focal: float | None
    notes: list[str] = field(default_factory=list)


def decode(path: Path) -> Decoded:
    """Read a photo or a style picture.

    16-bit values are scaled (65535 becomes 255), alpha is composited on white, an embedded ICC
    profile is converted to sRGB (relative colorimetric, black point compensated), the first frame
    of an animation is used, and all eight EXIF orientations are undone (in HEIC, whose standard
    gives EXIF no say in it, the file's own rotation).

    Args:
        path: JPEG, PNG, WebP, TIFF, AVIF, BMP, GIF, PPM, or HEIC where pillow-heif is installed.

    Raises:
        InputError: the file cannot be read, is no picture, is damaged or too large.
    """
    with opened_picture(path) as opened:
        notes: list[str] = []
        focal = read_equivalent_focal(opened)
        image = _upright(_to_srgb(opened, notes), opened)
    return Decoded(image, focal, [f"{path.name}: {note}" for note in notes])


@contextmanager
def opened_picture(path: Path) -> Iterator[Image.Image]:
    """A picture with its pixels as the file has them; raises as `decode`, in the block too."""
    with failures_named(path):
        data = read_file(path, Kind("a picture", LARGEST_FILE, lambda begun: begins(begun, path)))
        _refuse_by_content(path, data)
        with identified(path, data) as opened:
            _refuse_bombs(path, opened.width * opened.height, len(data))
            opened.load()
            yield opened


@contextmanager
def failures_named(path: Path) -> Iterator[None]:
    """Any way in which a decoder fails becomes one line that names the file."""
    # Pillow warns at its limit and refuses at twice that; the limit is the process's.
    Image.MAX_IMAGE_PIXELS = MAX_PIXELS // 2
    warnings.filterwarnings("ignore", category=Image.DecompressionBombWarning)
    try:
        yield
    except Image.DecompressionBombError as error:
        message = f"larger than {MAX_PIXELS // 10**6} megapixels; scale it down first"
        raise InputError(f"{path}: {message}") from error
    except MemoryError as error:
        raise InputError(f"{path}: does not fit into memory; scale it down first") from error
    except DECODER_FAILURES as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from error
        message = shortened(" ".join(str(error).split()))
        raise InputError(f"{path}: damaged or unsupported picture: {message}") from error


def _refuse_by_content(path: Path, data: bytes) -> None:
    """Errors that Pillow would describe less helpfully."""
    if not data:
        raise InputError(f"{path}: the file is empty")
    if path.suffix.lower() in RAW_SUFFIXES:
        raise InputError(f"{path}: camera raw; export it as JPEG or TIFF first")
    if data[4:8] == b"ftyp" and data[8:12] in HEIC_BRANDS:
        try:
            from pillow_heif import register_heif_opener
        except ImportError as error:
            if memory.ended(error):
                raise MemoryError from error
            raise InputError(
                f"{path}: HEIC needs an extra: pip install 'styl3r[heic]' (or export it as JPEG)"
            ) from error
        register_heif_opener()


def _refuse_bombs(path: Path, pixels: int, size: int) -> None:
    if pixels > BELIEVED_PIXELS and pixels > MOST_PIXELS_A_BYTE * size:
        what = f"{pixels // 10**6} megapixels in {size} bytes"
        raise InputError(f"{path}: {what} are no photo; scale it down first")


def _upright(image: Image.Image, opened: Image.Image) -> Image.Image:
    # Asked after loading: some of Pillow's readers turn the picture themselves and say so then.
    method = UPRIGHT.get(opened.getexif().get(ORIENTATION, 1))
    return image if method is None else image.transpose(method)


def _to_srgb(image: Image.Image, notes: list[str]) -> Image.Image:
    """8-bit RGB from any mode; the picture's alpha, if any, ends on white."""
    profile = image.info.get("icc_profile")
    if image.mode.startswith("I"):
        image = Image.fromarray(_eight_bits(image))
    elif image.mode == "F":
        raise ValueError("floating-point pixels; save it with 8 or 16 bits a channel")
    alpha = None
    if image.has_transparency_data:
        image = image.convert("RGBA")
        alpha = image.getchannel("A")
        image = image.convert("RGB")
    elif image.mode in ("1", "P", "HSV", "YCbCr", "RGBX"):
        image = image.convert("L" if image.mode == "1" else "RGB")
    colours = _apply_profile(image, profile, notes) if profile else None
    colours = colours or image.convert("RGB")
    if alpha is not None and np.asarray(alpha).min() < MAX_8_BIT:
        notes.append("transparent pixels were put on white")
        colours = Image.composite(colours, Image.new("RGB", colours.size, WHITE), alpha)
    return colours


def _eight_bits(image: Image.Image) -> NDArray[np.uint8]:
    """16-bit grey (modes I;16, I;16B, I) to 8 bits, rounded; Pillow's own conversion clips.

    In a TIFF, mode I is 32 bits or signed: whatever its values are, nothing says which one is
    white. Elsewhere it is how Pillow gives 16 bits, scaled to all of them.
    """
    values, most = np.asarray(image), MAX_16_BIT
    if image.format == "TIFF":
        if image.mode == "I":
            raise ValueError("32-bit or signed pixels; save it with 8 or 16 bits a channel")
        most = (1 << _tag(image, BITS_PER_SAMPLE, (16,))[0]) - 1  # 12 bits come as they are
        if _tag(image, PHOTOMETRIC_INTERPRETATION, None) == WHITE_IS_ZERO:
            values = most - values
    if values.min() < 0 or values.max() > most:
        raise ValueError(f"pixels beyond 0 to {most}; save it with 8 or 16 bits a channel")
    return ((values.astype(np.uint32) * MAX_8_BIT + most // 2) // most).astype(np.uint8)


def _tag(image: Image.Image, tag: int, default: Any) -> Any:
    """A field of a TIFF."""
    return getattr(image, "tag_v2", {}).get(tag, default)


def _apply_profile(image: Image.Image, profile: bytes, notes: list[str]) -> Image.Image | None:
    """The picture in sRGB, or None where there is nothing to convert or the profile is unusable."""
    try:
        source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        if "sRGB" in ImageCms.getProfileDescription(source):
            return None
        if source.profile.xcolor_space.strip() == "RGB" and image.mode == "L":
            image = image.convert("RGB")
        elif source.profile.xcolor_space.strip() == "GRAY" and image.mode == "RGB":
            image = image.convert("L")
        return ImageCms.profileToProfile(
            image,
            source,
            ImageCms.createProfile("sRGB"),
            renderingIntent=ImageCms.Intent.RELATIVE_COLORIMETRIC,
            outputMode="RGB",
            flags=ImageCms.Flags.BLACKPOINTCOMPENSATION,
        )
    except (ImageCms.PyCMSError, OSError, ValueError, TypeError):
        notes.append("the embedded colour profile cannot be used; taken as sRGB")
        return None
