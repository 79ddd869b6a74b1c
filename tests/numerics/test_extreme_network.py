"""The bundled network on what no photographer takes: a sound scene, whatever comes in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hostile_pictures import HOSTILE, SIDE, photos_of, wall

from styl3r_cli.cameras.recover import recover
from styl3r_cli.gaussians import FloatArray
from styl3r_cli.photos import Photos
from styl3r_cli.pipeline import Repairs, Scene, Stylizer, assemble
from styl3r_cli.splatting import render


@pytest.fixture(scope="module")
def stylizer() -> Stylizer:
    return Stylizer("mini", "cpu", threads=1)


STYLES: dict[str, FloatArray] = {
    "black": np.zeros((3, 64, 64), np.float32),
    "white": np.ones((3, 64, 64), np.float32),
    "checkers": np.tile(np.float32(np.indices((64, 64)).sum(axis=0) % 2), (3, 1, 1)),
    "smallest": wall(16, 16)[0],
}


def assert_sound(scene: Scene, colours: FloatArray) -> None:
    """What the graphs promise, before anything is repaired; and a picture of it."""
    for array in (scene.means, scene.scales, scene.rotations, scene.content_tokens, colours):
        assert np.isfinite(array).all()
    lengths = np.linalg.norm(scene.rotations, axis=-1)
    np.testing.assert_allclose(lengths, 1, atol=1e-4)
    assert scene.scales.min() > 0
    assert scene.opacities.min() >= 0
    assert scene.opacities.max() <= 1
    assert colours.min() >= 0
    assert colours.max() <= 1
    gaussians, repairs = assemble(scene, colours)
    assert repairs == Repairs()
    found = recover(scene.means, scene.opacities, scene.intrinsics, [True] * len(scene.means))
    for camera in found.cameras:
        assert np.isfinite(camera.extrinsics).all()
        assert np.linalg.det(camera.extrinsics[:3, :3]) == pytest.approx(1)
        frame = render(gaussians, camera, threads=1)
        assert frame.invalid == 0
        assert np.isfinite(frame.colour).all()
        assert frame.alpha.max() <= 1
    # Something is there to be seen: the first view never fades, whatever the others are.
    assert render(gaussians, found.cameras[0], threads=1).alpha.mean() > 0.3


@pytest.mark.parametrize("name", HOSTILE)
def test_any_views_make_a_sound_scene(stylizer: Stylizer, name: str) -> None:
    scene = stylizer.encode(HOSTILE[name]())
    colours = stylizer.colours(scene, [STYLES["checkers"]])
    assert np.isfinite(colours).all()
    assert 0 <= colours.min() <= colours.max() <= 1
    assert_sound(scene, stylizer.colours(scene, strength=0))


@pytest.mark.parametrize("style", STYLES)
def test_any_style_gives_sound_colours(stylizer: Stylizer, style: str) -> None:
    for photos in (photos_of(wall()), HOSTILE["black"]()):
        scene = stylizer.encode(photos)
        for strength in (0.5, 1.0):
            colours = stylizer.colours(scene, [STYLES[style]], strength=strength)
            assert np.isfinite(colours).all()
            assert 0 <= colours.min() <= colours.max() <= 1


def test_lenses_that_differ_by_a_hundred(stylizer: Stylizer) -> None:
    photos = photos_of(wall())
    intrinsics = photos.intrinsics.copy()
    intrinsics[0, :2, :2] *= 0.1
    intrinsics[1, :2, :2] *= 10
    scene = stylizer.encode(replace(photos, intrinsics=intrinsics))
    assert_sound(scene, stylizer.colours(scene, strength=0))


def test_the_strength_0_of_any_style_is_the_reconstruction(stylizer: Stylizer) -> None:
    scene = stylizer.encode(photos_of(wall()))
    own = stylizer.colours(scene, strength=0)
    for style in STYLES.values():
        np.testing.assert_array_equal(stylizer.colours(scene, [style], strength=0), own)


def test_one_pixel_of_noise_moves_nothing_far(stylizer: Stylizer) -> None:
    """A grey level in one pixel of an ordinary scene: no value is balanced on an edge."""
    images = wall()
    scene = stylizer.encode(photos_of(images))
    images[1, :, SIDE // 3, SIDE // 2] += np.float32(1 / 255)
    moved = stylizer.encode(photos_of(images))
    off = np.linalg.norm(moved.means - scene.means, axis=-1)
    assert np.median(off / np.linalg.norm(scene.means, axis=-1)) < 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("views", [3, 8])
@pytest.mark.parametrize("name", ["black", "one-pixel checkers", "saturated noise"])
def test_many_hostile_views(stylizer: Stylizer, name: str, views: int) -> None:
    two = HOSTILE[name]()
    images = np.concatenate([two.images] * 4)[:views]
    scene = stylizer.encode(photos_of(images))
    assert_sound(scene, stylizer.colours(scene, strength=0))


def test_the_views_are_as_described() -> None:
    """None of the above is a scene like any other by mistake."""
    for name, make in HOSTILE.items():
        photos: Photos = make()
        assert photos.images.shape[0] == 2
        assert not any(side % 16 for side in photos.images.shape[2:])
        assert 0 <= photos.images.min() <= photos.images.max() <= 1, name
    assert np.ptp(HOSTILE["contrast of 1/255"]().images) <= 2.01 / 255
