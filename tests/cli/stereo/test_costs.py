"""Costs against correlation worked out window by window, and what must not change them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wavy_wall import wall

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.matches import as_pictures
from styl3r_cli.stereo.costs import NOISE, UNSEEN, WINDOW, Look, Windows, plane_costs, surface_costs

SIDE = 24
CAMERA = Camera(np.eye(4), 30.0, 28.0, 11.0, 13.0, SIDE, SIDE)


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.1, 0.9, (SIDE, SIDE)).astype(np.float32)


def test_unlikeness_is_that_of_windows() -> None:
    a, b = noise(1), noise(2)
    found = Windows.of(a).unlike(b)
    half = WINDOW // 2
    for y, x in ((5, 7), (12, 12), (20, 3)):
        one, two = (
            each[y - half : y + half + 1, x - half : x + half + 1].astype(np.float64)
            for each in (a, b)
        )
        both = ((one - one.mean()) * (two - two.mean())).mean()
        likeness = both / np.sqrt((one.var() + NOISE) * (two.var() + NOISE))
        assert found[y, x] == pytest.approx((1 - likeness) / 2, abs=1e-5)


@settings(max_examples=30, deadline=None)
@given(st.floats(0.5, 1.0), st.floats(0.0, 0.4), st.integers(0, 1000))
def test_exposure_changes_hardly_anything(gain: float, lift: float, seed: int) -> None:
    a = noise(seed)
    shifted = (gain * a + lift).astype(np.float32)
    # NOISE counts in both: exact without it.
    assert Windows.of(a).unlike(shifted).max() < 0.05
    assert Windows.of(a).unlike(1 - a).min() > 0.95


def test_a_shift_is_the_plane_whose_parallax_it_is() -> None:
    picture = (255 * noise(3)).round().astype(np.uint8)[..., None].repeat(3, axis=-1)
    aside = np.roll(picture, -3, axis=1)  # a camera to the right sees all 3 pixels to the left
    pose = np.eye(4)
    pose[0, 3] = -0.5
    size = SIDE, SIDE
    first = Look.of(picture, CAMERA, size)
    other = Look.of(aside, replace(CAMERA, extrinsics=pose), size)
    nearness = np.array([2, 3, 4]) / (0.5 * CAMERA.fx)
    costs = plane_costs(first, [other], nearness)
    inner = costs[:, 4:-4, 8:-4]
    assert inner[1].max() < 0.01
    assert (inner.argmin(axis=0) == 1).all()
    # What moved out of the frame is as good as unknown.
    np.testing.assert_array_equal(costs[1, :, :3], np.float32(UNSEEN))
    # A plane as a surface gives the same.
    flat = np.full(size, nearness[1], np.float32)
    steps = (nearness - nearness[1]).astype(np.float32)
    np.testing.assert_allclose(surface_costs(first, [other], flat, steps), costs, atol=2e-3)


def test_one_view_with_something_in_between_is_outvoted() -> None:
    scene, recovered = wall(4)
    pictures = as_pictures(scene.images)
    size = scene.images.shape[2:]
    looks = [Look.of(*pair, size) for pair in zip(pictures, recovered.cameras, strict=True)]
    true = (1 / scene.means[0, ..., 2]).astype(np.float32)
    still = np.zeros(1, np.float32)
    hidden = replace(looks[2], grey=noise(5).repeat(8, axis=0).repeat(8, axis=1))
    clear = float(np.median(surface_costs(looks[0], looks[1:3], true, still)))
    covered = float(np.median(surface_costs(looks[0], [looks[1], hidden], true, still)))
    alone = float(np.median(surface_costs(looks[0], [hidden], true, still)))
    assert covered == pytest.approx(clear, abs=0.02)
    assert alone > clear + 0.3


def test_what_lies_behind_the_other_camera_is_unseen() -> None:
    pose = np.eye(4)
    pose[2, 3] = -3.0  # three units ahead
    first, other = Look(noise(1), CAMERA), Look(noise(2), replace(CAMERA, extrinsics=pose))
    surface = np.full((SIDE, SIDE), 1.0, np.float32)  # one unit ahead
    costs = surface_costs(first, [other], surface, np.zeros(1, np.float32))
    np.testing.assert_array_equal(costs, np.float32(UNSEEN))
