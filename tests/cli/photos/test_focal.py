"""Focal lengths from EXIF, with the values that real cameras and careless editors write."""

from __future__ import annotations

import io
import math

import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from styl3r_cli.errors import UsageError
from styl3r_cli.photos.focal import (
    focal_from_equivalent,
    focal_from_fov,
    read_equivalent_focal,
)

FULL_FRAME = (360, 240)


def equivalent(tags: dict[int, object], size: tuple[int, int] = FULL_FRAME) -> float | None:
    exif = Image.Exif()
    exif.get_ifd(0x8769).update(tags)
    buffer = io.BytesIO()
    Image.new("RGB", size).save(buffer, "JPEG", exif=exif)
    with Image.open(buffer) as image:
        return read_equivalent_focal(image)


def test_equivalent_focal_length() -> None:
    assert equivalent({0xA405: 26}) == 26


def test_full_frame_equivalent_is_the_focal_length_itself() -> None:
    """On a 36 x 24 mm frame of 360 x 240 pixels, 1 mm is 10 pixels."""
    assert focal_from_equivalent(50.0, *FULL_FRAME) == pytest.approx(500.0)
    assert focal_from_equivalent(50.0, 240, 360) == pytest.approx(500.0)


@pytest.mark.parametrize(("unit", "resolution"), [(2, 254.0), (3, 100.0), (4, 10.0), (None, 254.0)])
def test_focal_plane_resolution(unit: int | None, resolution: float) -> None:
    tags: dict[int, object] = {0x920A: IFDRational(35, 1), 0xA20E: IFDRational(int(resolution), 1)}
    if unit is not None:
        tags[0xA210] = unit
    assert equivalent(tags) == pytest.approx(35.0)


def test_focal_plane_resolution_of_a_photo_resized_since() -> None:
    tags = {0x920A: IFDRational(35, 1), 0xA20E: IFDRational(1000, 1), 0xA210: 3, 0xA002: 3600}
    assert equivalent(tags) == pytest.approx(35.0)


@pytest.mark.parametrize("absurd", [0, 1, 65535])
def test_absurd_equivalents_fall_through(absurd: int) -> None:
    assert equivalent({0xA405: absurd}) is None
    tags = {0xA405: absurd, 0x920A: IFDRational(35, 1), 0xA20E: IFDRational(100, 1), 0xA210: 3}
    assert equivalent(tags) == pytest.approx(35.0)


def test_division_by_zero_and_missing_tags() -> None:
    assert equivalent({}) is None
    assert equivalent({0x920A: IFDRational(0, 0), 0xA20E: IFDRational(100, 1)}) is None
    assert equivalent({0x920A: IFDRational(4, 1)}) is None


def test_fov_is_horizontal() -> None:
    assert focal_from_fov(90.0, 640) == pytest.approx(320.0)
    assert math.degrees(2 * math.atan(320 / focal_from_fov(60.0, 640))) == pytest.approx(60.0)


@pytest.mark.parametrize("degrees", [0.0, -5.0, 180.0, math.nan, math.inf])
def test_impossible_fov(degrees: float) -> None:
    with pytest.raises(UsageError, match="--fov"):
        focal_from_fov(degrees, 640)
