"""Focal lengths: from EXIF, from a field of view, or assumed; as 35 mm equivalents."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from PIL import Image

from styl3r_cli.errors import UsageError

# "35 mm equivalent" compares diagonals (CIPA DCG-001): a 36 x 24 mm frame's is 43.27 mm.
FILM_DIAGONAL = math.hypot(36.0, 24.0)
# Phones' main cameras have 24 to 28 mm, compact cameras and kit lenses 28 to 35 mm at their wide
# end, so 28 mm is at most about a fifth off for either: 65 degrees across a 3:2 photo.
ASSUMED_FOCAL = 28.0
# From a fisheye to a long telescope; EXIF values outside (0 and 65535 are common) mean "unknown".
SHORTEST_FOCAL, LONGEST_FOCAL = 5.0, 3000.0
NARROWEST_FOV, WIDEST_FOV = 1.0, 170.0  # degrees; a pinhole camera has nothing to say beyond

EXIF_IFD = 0x8769
FOCAL_LENGTH = 0x920A  # mm
FOCAL_LENGTH_35MM = 0xA405  # mm, equivalent
PLANE_X_RESOLUTION = 0xA20E  # pixels per unit on the sensor
PLANE_UNIT = 0xA210
PIXEL_X_DIMENSION = 0xA002  # the width that the resolution refers to
MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # inch (the default), cm; mm, um as some write


def read_equivalent_focal(image: Image.Image) -> float | None:
    """A photo's 35 mm equivalent focal length from EXIF, in mm; None where unknown or absurd.

    FocalLengthIn35mmFilm is used first, since it survives resizing and accounts for digital zoom;
    then FocalLength with the sensor's resolution (FocalPlaneXResolution).
    """
    try:
        tags = image.getexif().get_ifd(EXIF_IFD)
    except Exception:  # a damaged EXIF block must not lose the photo, however the parser fails
        return None
    equivalent = _number(tags, FOCAL_LENGTH_35MM)
    if _plausible(equivalent):
        return equivalent
    focal, resolution = _number(tags, FOCAL_LENGTH), _number(tags, PLANE_X_RESOLUTION)
    if focal is None or not resolution:
        return None
    unit = MM_PER_UNIT.get(int(_number(tags, PLANE_UNIT) or 2), MM_PER_UNIT[2])
    resized = image.width / (_number(tags, PIXEL_X_DIMENSION) or image.width)
    pixels = focal * resolution / unit * resized
    equivalent = pixels * FILM_DIAGONAL / math.hypot(image.width, image.height)
    return equivalent if _plausible(equivalent) else None


def focal_from_equivalent(equivalent: float, width: int, height: int) -> float:
    """Pixels from millimetres: the photo's diagonal stands for the film's."""
    return equivalent * math.hypot(width, height) / FILM_DIAGONAL


def equivalent_from_focal(pixels: float, width: int, height: int) -> float:
    """Millimetres from pixels, the inverse of `focal_from_equivalent`."""
    return pixels * FILM_DIAGONAL / math.hypot(width, height)


def focal_from_fov(degrees: float, width: int) -> float:
    """Pixels from the horizontal field of view of a photo as it is shown (upright).

    Raises:
        UsageError: the angle is outside what a pinhole camera can have.
    """
    if not NARROWEST_FOV <= degrees <= WIDEST_FOV:
        raise UsageError(
            f"--fov {degrees:g}: horizontal field of view in degrees, "
            f"{NARROWEST_FOV:g} to {WIDEST_FOV:g}"
        )
    return width / 2 / math.tan(math.radians(degrees) / 2)


def _number(tags: Mapping[int, Any], tag: int) -> float | None:
    try:
        value = float(tags[tag])
    except (KeyError, TypeError, ValueError, ArithmeticError):
        return None
    return value if math.isfinite(value) else None


def _plausible(equivalent: float | None) -> bool:
    return equivalent is not None and SHORTEST_FOCAL <= equivalent <= LONGEST_FOCAL
