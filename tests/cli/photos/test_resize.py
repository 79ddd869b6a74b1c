"""Resize and crop: bit for bit the published network's, and the intrinsics that go with them."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from styl3r_cli.photos import resize as resize_module
from styl3r_cli.photos.resize import detail_size, fit_intrinsics, fit_map, fit_photo, fit_style


@pytest.fixture(scope="module")
def fixtures(shared: Path) -> dict[str, np.ndarray]:
    with np.load(shared / "reference" / "unit_fixtures.npz") as file:
        return {name: file[name] for name in file.files if "crop/" in name}


@pytest.fixture(scope="module")
def recipe(shared: Path) -> ModuleType:
    path = shared / "reference" / "weights_recipe.py"
    spec = importlib.util.spec_from_file_location("weights_recipe", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("case", ["landscape", "portrait", "wide", "exact"])
def test_photos_match_the_reference(
    fixtures: dict[str, np.ndarray], recipe: ModuleType, case: str
) -> None:
    seed, height, width = fixtures[f"crop/{case}/image_seed_h_w"].tolist()
    images = recipe.make_content_images(seed, 2, height, width)
    expected = fixtures[f"crop/{case}/out"]
    size = expected.shape[1:3]
    to_pixels = np.array([[width], [height], [1]])
    for view in range(2):
        assert np.array_equal(fit_photo(Image.fromarray(images[view]), size), expected[view])
        known = fixtures[f"crop/{case}/K_in"][view].astype(np.float64)
        fitted = fit_intrinsics(known * to_pixels, (width, height), size)
        reference = fixtures[f"crop/{case}/K_out"][view]
        np.testing.assert_allclose(np.diag(fitted), np.diag(reference), rtol=1e-6)


@pytest.mark.parametrize("case", ["landscape", "portrait", "small", "square"])
def test_styles_match_the_reference(
    fixtures: dict[str, np.ndarray], recipe: ModuleType, case: str
) -> None:
    seed, height, width = fixtures[f"style_crop/{case}/image_seed_h_w"].tolist()
    image = np.asarray(recipe.make_style_image(seed, height, width))
    fitted = fit_style(Image.fromarray(image), 256)
    assert fitted.shape == (256, 256, 3)
    assert np.array_equal(fitted[::4, ::4], fixtures[f"style_crop/{case}/out_every_4th"])
    total = fitted.sum(axis=(0, 1), dtype=np.int64)
    assert np.array_equal(total, fixtures[f"style_crop/{case}/out_sum"])


sides = st.integers(1, 400)
targets = st.sampled_from([16, 32, 48, 64, 96])


@given(sides, sides, targets, targets)
@settings(max_examples=60, deadline=None)
def test_any_photo_fills_the_frame(width: int, height: int, rows: int, columns: int) -> None:
    image = Image.new("RGB", (width, height), (9, 99, 199))
    fitted = fit_photo(image, (rows, columns))
    assert fitted.shape == (rows, columns, 3)
    assert (fitted == (9, 99, 199)).all()  # no border of another colour anywhere


def test_a_sliver_of_an_enlarged_photo_is_not_cut_from_a_whole_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (48, 65, 3), dtype=np.uint8)
    photo = Image.fromarray(noise).resize((260, 192), Image.Resampling.BICUBIC)
    sizes: list[tuple[int, int]] = []
    plain = Image.Image.resize

    def resize(image: Image.Image, size: tuple[int, int], *rest: Any, **more: Any) -> Image.Image:
        sizes.append(size)
        return plain(image, size, *rest, **more)

    monkeypatch.setattr(Image.Image, "resize", resize)
    assert fit_photo(photo, (16384, 16)).shape == (16384, 16, 3)
    assert sizes == [(16, 16384)]  # the whole one has 22187x16384 pixels: 1.5 GB
    for size in ((512, 16), (16, 512), (301, 64)):
        usual = fit_photo(photo, size)
        with monkeypatch.context() as patch:
            patch.setattr(resize_module, "MOST_WHOLE_PIXELS", 0)
            away = np.abs(fit_photo(photo, size) - usual.astype(int))
        # Between its two passes Pillow rounds to 8 bits, and the smaller one comes first.
        assert away.max() <= 4
        assert away.mean() < 0.5


@given(st.integers(16, 300), st.integers(16, 300), st.floats(0.3, 0.7), st.floats(0.3, 0.7))
@settings(max_examples=100, deadline=None)
def test_intrinsics_follow_the_pixels(width: int, height: int, cx: float, cy: float) -> None:
    """A point lands where the resize and the crop carry it, to the half pixel of an odd margin."""
    rows, columns = 48, 96
    intrinsics = np.array([[200.0, 0, cx * width], [0, 210.0, cy * height], [0, 0, 1]])
    ray = np.array([0.1, -0.07, 1.0])
    u, v, _ = intrinsics @ ray
    factor = max(rows / height, columns / width)
    resized_height, resized_width = round(height * factor), round(width * factor)
    u = u * resized_width / width - (resized_width - columns) // 2
    v = v * resized_height / height - (resized_height - rows) // 2
    normalised = fit_intrinsics(intrinsics, (width, height), (rows, columns))
    fitted_u, fitted_v, _ = (normalised.astype(np.float64) @ ray) * [columns, rows, 1]
    assert abs(fitted_u - u) <= 0.5 + 1e-3
    assert abs(fitted_v - v) <= 0.5 + 1e-3


def test_centred_principal_point_stays_centred() -> None:
    odd_margin = fit_intrinsics(
        np.array([[300.0, 0, 200], [0, 300, 150], [0, 0, 1]]), (400, 300), (256, 256)
    )
    np.testing.assert_array_equal(odd_margin[:2, 2], [0.5, 0.5])


@pytest.mark.parametrize("photo", [(96, 80), (60, 200), (33, 31), (64, 64)])
@pytest.mark.parametrize("factor", [0.5, 1, 3])
def test_a_map_is_cropped_as_its_photo(photo: tuple[int, int], factor: float) -> None:
    """Where each pixel is from, as told by a photo of it and by a map in another resolution."""
    shape = [round(side * factor) for side in photo[::-1]]
    for axis in (0, 1):  # down, across
        place = (np.arange(photo[1 - axis]) + 0.5) / photo[1 - axis] * 255
        shown = (
            np.broadcast_to(np.expand_dims(place, 1 - axis), photo[::-1]).round().astype(np.uint8)
        )
        image = Image.fromarray(np.repeat(shown[..., None], 3, axis=2))
        found = (np.arange(shape[axis]) + 0.5) / shape[axis] * 255
        values = np.broadcast_to(np.expand_dims(found, 1 - axis), shape)
        off = fit_map(values, photo, (48, 32)) - fit_photo(image, (48, 32))[..., 0].astype(float)
        pixel = 255 / min(photo[1 - axis], shape[axis])  # the larger one
        assert np.abs(off[4:-4, 4:-4]).max() <= pixel / 2 + 1.5  # of rounding to 8 bits
        assert abs(np.median(off)) <= pixel / 4 + 1


@pytest.mark.parametrize(
    ("photo", "size", "detail"),
    [
        ((4032, 3024), (256, 256), (512, 512)),  # twice as large
        ((640, 427), (256, 256), (427, 427)),  # no more than there is
        ((640, 400), (192, 256), (384, 512)),
        ((300, 200), (256, 256), (256, 256)),  # nor less than the network gets
        ((8000, 8000), (768, 768), (1024, 1024)),  # not too much
        ((8000, 8000), (2048, 1024), (2048, 1024)),
    ],
)
def test_features_are_sought_in_what_a_photo_has(
    photo: tuple[int, int], size: tuple[int, int], detail: tuple[int, int]
) -> None:
    assert detail_size(photo, size) == detail
