"""Views and styles as the graphs read them, and the notes that come with them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.errors import InputError, UsageError
from styl3r_cli.photos.expand import expand
from styl3r_cli.photos.load import load_photos, load_style, spread


def save(path: Path, seed: int = 0, size: tuple[int, int] = (80, 60), **options: object) -> Path:
    """A blurry random photo: other seeds are other scenes."""
    coarse = np.random.default_rng(seed).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    image = Image.fromarray(coarse).resize(size, Image.Resampling.BICUBIC)
    image.save(path, **options)  # type: ignore[arg-type]
    return path


def with_focal(equivalent: int) -> Image.Exif:
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = equivalent
    return exif


SIZE = (32, 48)


def test_shapes_ranges_and_names(tmp_path: Path) -> None:
    paths = [save(tmp_path / "a.png", 1), save(tmp_path / "b.png", 2, (60, 80))]
    photos = load_photos(paths, SIZE)
    assert photos.images.shape == (2, 3, 32, 48)
    assert photos.images.dtype == photos.intrinsics.dtype == np.float32
    assert 0 <= photos.images.min() < photos.images.max() <= 1
    assert photos.names == ["a.png", "b.png"]
    assert photos.sizes == [(80, 60), (60, 80)]
    assert photos.focal_sources == ["assumed", "assumed"]
    assert len(photos.notes) == 1
    assert "no focal length in a.png, b.png: 28 mm equivalent assumed" in photos.notes[0]
    # What features are sought in: 80x60 and 60x80 are 1.67 and 1.25 times as large as the frame.
    assert [detail.shape for detail in photos.details] == [(53, 80, 3), (40, 60, 3)]
    for detail, image in zip(photos.details, photos.images, strict=True):
        shown = cv2.resize(detail, (48, 32), interpolation=cv2.INTER_AREA).transpose(2, 0, 1) / 255
        assert np.abs(shown - image).mean() < 0.1


def test_fov_is_that_of_the_photo_as_shown(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6  # stored 60 x 80, shown 80 x 60
    paths = [save(tmp_path / f"{i}.png", i, (60, 80), exif=exif) for i in range(2)]
    photos = load_photos(paths, (48, 64), fov=90.0)
    assert photos.sizes == [(80, 60)] * 2
    np.testing.assert_allclose(photos.intrinsics[:, 0, 0], 0.5, rtol=1e-6)
    np.testing.assert_allclose(photos.intrinsics[:, 1, 1], 0.5 * 4 / 3, rtol=1e-6)
    assert photos.focals_measured == [True, True]


def test_exif_focal_and_its_loan_to_other_photos(tmp_path: Path) -> None:
    known = save(tmp_path / "a.jpg", 1, exif=with_focal(35))
    other = save(tmp_path / "b.jpg", 2)
    photos = load_photos([known, other], SIZE)
    assert photos.focal_sources == ["exif", "other photos"]
    expected = 35 * 100 / np.hypot(36, 24) / 80  # diagonal 100, width 80 and not cropped
    np.testing.assert_allclose(photos.intrinsics[:, 0, 0], expected, rtol=1e-6)
    assert any("35 mm equivalent taken from the other photos" in note for note in photos.notes)


def test_zoom_between_views_is_noted(tmp_path: Path) -> None:
    paths = [save(tmp_path / f"{mm}.jpg", mm, exif=with_focal(mm)) for mm in (26, 52)]
    notes = load_photos(paths, SIZE).notes
    assert "focal lengths differ: 26 mm equivalent in 26.jpg, 52 mm in 52.jpg" in notes


def test_given_cameras_beat_everything(tmp_path: Path) -> None:
    paths = [save(tmp_path / f"{i}.jpg", i, exif=with_focal(26)) for i in (1, 2)]
    camera = Camera(np.eye(4), 80.0, 88.0, 88.0, 60.0, 160, 120)
    photos = load_photos(paths, (48, 64), fov=50.0, cameras={paths[1]: camera})
    assert photos.focal_sources == ["fov", "cameras"]
    expected = [[0.5, 0, 0.55], [0, 88 / 120, 0.5], [0, 0, 1]]
    np.testing.assert_allclose(photos.intrinsics[1], expected, rtol=1e-6)


def test_camera_of_another_shape_is_refused(tmp_path: Path) -> None:
    paths = [save(tmp_path / f"{i}.jpg", i) for i in (1, 2)]
    camera = Camera(np.eye(4), 80.0, 80.0, 30.0, 40.0, 60, 80)
    with pytest.raises(
        InputError, match=r"2\.jpg: the photo is 80x60, but its camera is for 60x80"
    ):
        load_photos(paths, SIZE, cameras={paths[1]: camera})


def test_fewer_than_two_views(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"only one photo .*a\.png.* needs 2 to 8 views"):
        load_photos([save(tmp_path / "a.png")], SIZE)
    with pytest.raises(InputError, match="no photo was given; a scene needs 2 to 8"):
        load_photos([], SIZE)


def test_unreadable_photos_are_left_out_while_two_remain(tmp_path: Path) -> None:
    paths = [save(tmp_path / f"{i}.png", i) for i in range(3)]
    paths[1].write_bytes(b"")
    photos = load_photos(paths, SIZE)
    assert photos.names == ["0.png", "2.png"]
    assert f"left out: {paths[1]}: the file is empty" in photos.notes
    paths[2].write_bytes(b"junk")
    with pytest.raises(InputError, match=r"3 photos, but only .*0\.png can be used: .*1\.png") as e:
        load_photos(paths, SIZE)
    assert "2.png" in str(e.value)


def test_more_than_eight_are_spread_and_an_unreadable_one_replaced(tmp_path: Path) -> None:
    paths = [save(tmp_path / f"{i}.png", i) for i in range(15)]
    photos = load_photos(paths, SIZE)
    assert photos.names == [f"{i}.png" for i in range(0, 15, 2)]
    chosen = ", ".join(photos.names)
    assert f"15 photos, of which 8 are used: {chosen}" in photos.notes
    paths[0].write_bytes(b"junk")
    photos = load_photos(paths, SIZE)
    assert len(photos.names) == 8
    assert photos.names[0] == "1.png"
    assert photos.names[-1] == "14.png"


def test_spread_keeps_the_ends() -> None:
    for count in range(2, 100):
        indices = spread(count, 8)
        assert len(indices) == len(set(indices)) == min(count, 8)
        assert indices[0] == 0
        assert indices[-1] == count - 1
        gaps = np.diff(indices)
        assert gaps.max() - gaps.min() <= 1


def test_repeated_photos_are_named(tmp_path: Path) -> None:
    first = save(tmp_path / "a.png", 1, (300, 200))
    again = save(tmp_path / "b.jpg", 1, (300, 200), quality=60)
    other = save(tmp_path / "c.png", 2, (300, 200))
    notes = load_photos([first, again, other, first], (256, 256)).notes
    assert f"{first} and {again} are nearly identical: no parallax between them" in notes
    assert f"{first} and {first} are identical: no parallax between them" in notes
    assert not any(str(other) in note for note in notes if "identical" in note)


def test_small_photos_are_enlarged_with_a_note(tmp_path: Path) -> None:
    paths = [save(tmp_path / "a.png", 1, (20, 17)), save(tmp_path / "b.png", 2)]
    photos = load_photos(paths, SIZE)
    assert photos.images.shape == (2, 3, 32, 48)
    assert "smaller than 48x32, so enlarged: a.png (20x17)" in photos.notes


def test_slivers_and_odd_sizes_are_refused(tmp_path: Path) -> None:
    paths = [save(tmp_path / f"{i}.png", i) for i in (1, 2)]
    Image.new("RGB", (1, 101)).save(tmp_path / "sliver.png")
    with pytest.raises(InputError, match="1x101 pixels is too narrow"):
        load_style(tmp_path / "sliver.png")
    with pytest.raises(UsageError, match="multiples of 16"):
        load_photos(paths, (250, 256))
    with pytest.raises(UsageError, match="99984x99984: at most 4096x4096"):
        load_photos(paths, (99984, 99984))


def test_style(tmp_path: Path) -> None:
    style = load_style(save(tmp_path / "art.jpg", 3, (90, 50)), 64)
    assert style.name == "art.jpg"
    assert style.image.shape == (3, 64, 64)
    assert style.image.dtype == np.float32
    assert 0 <= style.image.min() < style.image.max() <= 1
    with pytest.raises(InputError, match="no such style picture"):
        load_style(tmp_path / "gone.jpg")


def test_real_scenes(shared: Path) -> None:
    folder = shared / "data" / "scenes" / "fern" / "images"
    if not folder.is_dir():
        pytest.skip("no real photos beside the reference data")
    photos = load_photos(expand([str(folder)]))
    assert photos.images.shape == (8, 3, 256, 256)
    assert photos.images.std() > 0.05
    assert not any("identical" in note for note in photos.notes)
