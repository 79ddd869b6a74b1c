"""Decoding: every format, depth, colour space and rotation ends as the same upright picture."""

from __future__ import annotations

import io
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageCms

from styl3r_cli.errors import InputError
from styl3r_cli.photos import decode as decode_module
from styl3r_cli.photos.decode import decode

Pixels = NDArray[np.uint8]
# Where the row and column of the stored picture's first pixel lie in the shown one (EXIF 2.3,
# "Orientation"), as a function that makes the stored picture from the shown one.
STORED_FROM_SHOWN = {
    1: lambda p: p,
    2: lambda p: p[:, ::-1],
    3: lambda p: p[::-1, ::-1],
    4: lambda p: p[::-1],
    5: lambda p: p.transpose(1, 0, 2),
    6: lambda p: p.transpose(1, 0, 2)[::-1],
    7: lambda p: p.transpose(1, 0, 2)[::-1, ::-1],
    8: lambda p: p.transpose(1, 0, 2)[:, ::-1],
}


def pixels(path: Path) -> Pixels:
    return np.asarray(decode(path).image)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp", ".tif"])
def test_all_orientations(tmp_path: Path, picture: Pixels, suffix: str, orientation: int) -> None:
    stored = Image.fromarray(np.ascontiguousarray(STORED_FROM_SHOWN[orientation](picture)))
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / f"a{suffix}"
    options = {".webp": {"lossless": True}, ".jpg": {"quality": 100, "subsampling": 0}}
    stored.save(path, exif=exif, **options.get(suffix, {}))
    shown = pixels(path)
    assert shown.shape == picture.shape
    tolerance = 4 if suffix == ".jpg" else 0
    assert np.abs(shown.astype(int) - picture).max() <= tolerance


def test_nonsense_orientation_is_ignored(tmp_path: Path, picture: Pixels) -> None:
    exif = Image.Exif()
    exif[0x0112] = 77
    Image.fromarray(picture).save(tmp_path / "a.png", exif=exif)
    assert np.array_equal(pixels(tmp_path / "a.png"), picture)


@pytest.mark.parametrize("name", ["a.png", "a.tif", "big-endian.tif"])
def test_16_bit_grey_is_scaled_and_not_clipped(tmp_path: Path, name: str) -> None:
    values = np.linspace(0, 65535, 48 * 64).reshape(48, 64).astype(np.uint16)
    if name.startswith("big"):
        image = Image.frombytes("I;16B", (64, 48), values.astype(">u2").tobytes())
    else:
        image = Image.fromarray(values)
    image.save(tmp_path / name)
    expected = np.round(values / 65535 * 255)
    for channel in np.moveaxis(pixels(tmp_path / name), -1, 0):
        assert np.array_equal(channel, expected)


def test_16_bit_colour(tmp_path: Path, picture: Pixels) -> None:
    cv2 = pytest.importorskip("cv2")
    cv2.imwrite(str(tmp_path / "a.png"), picture[..., ::-1].astype(np.uint16) * 257)
    assert np.array_equal(pixels(tmp_path / "a.png"), picture)


def test_grey_bilevel_and_palette(tmp_path: Path) -> None:
    grey = np.tile(np.arange(0, 256, 4, dtype=np.uint8), (48, 1))
    Image.fromarray(grey).save(tmp_path / "grey.png")
    assert np.array_equal(pixels(tmp_path / "grey.png"), np.stack([grey] * 3, -1))
    Image.fromarray(grey > 100).save(tmp_path / "bilevel.png")
    assert np.array_equal(pixels(tmp_path / "bilevel.png")[..., 1], (grey > 100) * np.uint8(255))
    four = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [9, 8, 7]], np.uint8)
    coloured = four[np.arange(48 * 64).reshape(48, 64) % 4]
    Image.fromarray(coloured).quantize(4).save(tmp_path / "palette.gif")
    assert np.array_equal(pixels(tmp_path / "palette.gif"), coloured)


def test_alpha_is_put_on_white(tmp_path: Path, picture: Pixels) -> None:
    alpha = np.full(picture.shape[:2], 255, np.uint8)
    alpha[:, :20] = 0
    alpha[:, 20:40] = 128
    Image.fromarray(np.dstack([picture, alpha])).save(tmp_path / "a.png")
    decoded = decode(tmp_path / "a.png")
    cover = alpha[..., None] / 255
    expected = picture * cover + 255 * (1 - cover)
    assert np.abs(np.asarray(decoded.image) - expected).max() <= 1
    assert decoded.notes == ["a.png: transparent pixels were put on white"]


def test_palette_with_a_transparent_colour(tmp_path: Path) -> None:
    image = Image.new("P", (8, 8), 0)
    image.putpalette([10, 20, 30, 200, 100, 50])
    image.paste(1, (0, 0, 4, 8))
    image.save(tmp_path / "a.png", transparency=0)
    shown = pixels(tmp_path / "a.png")
    assert shown[0, 0].tolist() == [200, 100, 50]
    assert shown[0, 7].tolist() == [255, 255, 255]


def test_opaque_alpha_changes_nothing(tmp_path: Path, picture: Pixels) -> None:
    alpha = np.full((*picture.shape[:2], 1), 255, np.uint8)
    Image.fromarray(np.concatenate([picture, alpha], -1)).save(tmp_path / "a.webp", lossless=True)
    decoded = decode(tmp_path / "a.webp")
    assert np.array_equal(np.asarray(decoded.image), picture)
    assert decoded.notes == []


def test_cmyk_jpeg(tmp_path: Path) -> None:
    for name, ink, colour in [
        ("cyan", (255, 0, 0, 0), (0, 255, 255)),
        ("paper", (0, 0, 0, 0), (255, 255, 255)),
        ("black", (0, 0, 0, 255), (0, 0, 0)),
    ]:
        Image.new("CMYK", (16, 16), ink).save(tmp_path / f"{name}.jpg", quality=100)
        assert np.abs(pixels(tmp_path / f"{name}.jpg").astype(int) - colour).max() <= 2


def linear_profile() -> bytes:
    """An RGB profile with sRGB's primaries and a linear curve, so that the answer is a formula."""
    profile = bytearray(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())
    count = int.from_bytes(profile[128:132], "big")
    for entry in range(132, 132 + 12 * count, 12):
        if profile[entry : entry + 4] in (b"rTRC", b"gTRC", b"bTRC"):
            offset = int.from_bytes(profile[entry + 4 : entry + 8], "big")
            profile[offset : offset + 12] = b"curv" + bytes(8)  # no entries: the identity
            profile[entry + 8 : entry + 12] = (12).to_bytes(4, "big")
    return bytes(profile).replace("sRGB".encode("utf-16-be"), "line".encode("utf-16-be"))


def test_colour_profile_is_converted_to_srgb(tmp_path: Path) -> None:
    ramp = np.repeat(np.tile(np.arange(256, dtype=np.uint8), (4, 1))[..., None], 3, -1)
    Image.fromarray(ramp).save(tmp_path / "a.png", icc_profile=linear_profile())
    linear = ramp / 255
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(pixels(tmp_path / "a.png") - 255 * curve).max() <= 1.5


def test_srgb_profile_leaves_every_bit(tmp_path: Path, picture: Pixels) -> None:
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(picture).save(tmp_path / "a.png", icc_profile=srgb)
    assert np.array_equal(pixels(tmp_path / "a.png"), picture)


def test_broken_profile_is_noted_and_ignored(tmp_path: Path, picture: Pixels) -> None:
    Image.fromarray(picture).save(tmp_path / "a.png", icc_profile=b"nonsense" * 40)
    decoded = decode(tmp_path / "a.png")
    assert np.array_equal(np.asarray(decoded.image), picture)
    assert "colour profile cannot be used" in decoded.notes[0]


@pytest.mark.parametrize("orientation", range(1, 9))
def test_heic(tmp_path: Path, picture: Pixels, orientation: int) -> None:
    """pillow-heif writes the orientation as the file's own rotation, as phones do."""
    heif = pytest.importorskip("pillow_heif", reason="the heic extra is not installed")
    heif.register_heif_opener()
    exif = Image.Exif()
    exif[0x0112] = orientation
    stored = Image.fromarray(np.ascontiguousarray(STORED_FROM_SHOWN[orientation](picture)))
    stored.save(tmp_path / "a.heic", exif=exif.tobytes(), quality=95)
    shown = pixels(tmp_path / "a.heic")
    assert shown.shape == picture.shape
    assert np.abs(shown.astype(int) - picture).mean() < 4


def test_heic_without_the_extra_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    path = tmp_path / "a.jpg"  # phones' exports often have the wrong suffix
    path.write_bytes(b"\x00\x00\x00\x18ftypheic" + bytes(50))
    with pytest.raises(InputError, match=r"pip install 'styl3r\[heic\]'"):
        decode(path)


def jpeg(picture: Pixels) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "JPEG")
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (lambda p: b"", "the file is empty"),
        (lambda p: b"hello, not a picture", "not a picture"),
        (lambda p: jpeg(p)[:-200], "damaged"),
        (lambda p: jpeg(p)[:100], "damaged|not a picture"),
        (lambda p: b"\x89PNG\r\n\x1a\n" + bytes(60), "damaged|not a picture"),
    ],
)
def test_unusable_files_are_named(
    tmp_path: Path, picture: Pixels, content: object, words: str
) -> None:
    path = tmp_path / "broken photo.jpg"
    path.write_bytes(content(picture))  # type: ignore[operator]
    with pytest.raises(InputError, match=f"broken photo.jpg: .*({words})") as caught:
        decode(path)
    assert "\n" not in str(caught.value)


def test_missing_and_folder(tmp_path: Path) -> None:
    for path in (tmp_path / "gone.jpg", tmp_path):
        with pytest.raises(InputError, match="cannot be read"):
            decode(path)


def test_decompression_bomb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decode_module, "MAX_PIXELS", 2_000_000)
    Image.new("1", (2000, 1500)).save(tmp_path / "a.png")
    with pytest.raises(InputError, match="larger than 2 megapixels"):
        decode(tmp_path / "a.png")


def test_float_and_32_bit_pictures_are_refused_with_advice(tmp_path: Path) -> None:
    Image.fromarray(np.ones((8, 8), np.float32)).save(tmp_path / "f.tif")
    Image.fromarray(np.full((8, 8), 10**6, np.int32)).save(tmp_path / "i.tif")
    # Nothing says what white is: 248 would be nearly black of 16 bits, and quite of 32.
    Image.fromarray(np.full((8, 8), 248, np.int32)).save(tmp_path / "small.tif")
    Image.fromarray(np.full((8, 8), 248, np.float32)).save(tmp_path / "large.tif")
    for name in ("f.tif", "i.tif", "small.tif", "large.tif"):
        with pytest.raises(InputError, match="8 or 16 bits"):
            decode(tmp_path / name)


def test_pictures_of_an_unknown_kind_are_not_called_no_pictures(tmp_path: Path) -> None:
    """Half floats, as painting programs export them: Pillow knows no mode for these."""
    Image.fromarray(np.ones((8, 8), np.float32)).save(tmp_path / "half.tif")
    data = (tmp_path / "half.tif").read_bytes()
    bits = struct.pack("<HHIHH", 258, 3, 1, 32, 0)  # BitsPerSample
    assert bits in data
    (tmp_path / "half.tif").write_bytes(data.replace(bits, struct.pack("<HHIHH", 258, 3, 1, 16, 0)))
    (tmp_path / "cut.heic").write_bytes(b"\x00\x00\x00\x18ftypheic" + bytes(50))
    for name, kind in (("half.tif", "TIFF"), ("cut.heic", "HEIF")):
        with pytest.raises(InputError, match=f": {kind}, but damaged or .* 8 or 16 bits"):
            decode(tmp_path / name)


def test_16_bit_greymaps_have_a_white_of_their_own(tmp_path: Path) -> None:
    values = np.array([[0, 500, 1000]], ">u2")
    (tmp_path / "a.pgm").write_bytes(b"P5 3 1 1000\n" + values.tobytes())
    assert np.asarray(decode(tmp_path / "a.pgm").image)[0, :, 0].tolist() == [0, 128, 255]


def test_12_bit_grey_is_scaled(tmp_path: Path) -> None:
    """Two pixels in three bytes, as scanners and cameras for science pack them."""
    entries = [(256, 2), (257, 1), (258, 12), (259, 1), (262, 1), (273, 122), (277, 1), (278, 1)]
    entries += [(279, 3)]
    table = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in entries)
    head = struct.pack("<2sHIH", b"II", 42, 8, len(entries))
    file = (head + table + bytes(4)).ljust(122, b"\0") + bytes([0xFF, 0xF8, 0x00])
    (tmp_path / "a.tif").write_bytes(file)
    assert np.asarray(decode(tmp_path / "a.tif").image)[0, :, 0].tolist() == [255, 128]
