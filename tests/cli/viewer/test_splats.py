"""What viser draws are the scene's Gaussians: covariances against a float64 oracle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from styl3r_cli.gaussians import Gaussians
from styl3r_cli.viewer.splats import (
    AWAY,
    FAINTEST,
    LARGEST,
    ROWS,
    THINNEST,
    least_scales,
    to_splats,
)
from styl3r_cli.viewer.start import View

Array = NDArray[np.float64]


def make(scales: Array, seed: int = 3) -> Gaussians:
    rng = np.random.default_rng(seed)
    count = len(scales)
    rotations = rng.normal(size=(count, 4))
    return Gaussians(
        means=rng.uniform(-2, 2, (count, 3)),
        scales=scales,
        rotations=rotations / np.linalg.norm(rotations, axis=1, keepdims=True),
        opacities=rng.uniform(0, 1, count),
        colours=rng.uniform(-0.3, 1.4, (count, 3)),
    )


def turn(quaternion: Array, vector: Array) -> Array:
    """Turn a vector by Hamilton's product q v q*, in which no rotation matrix occurs."""
    w, axis = quaternion[0], quaternion[1:]
    return vector + 2 * np.cross(axis, np.cross(axis, vector) + w * vector)


def covariance(scales: Array, quaternion: Array) -> Array:
    """The sum of s^2 a a^T over the Gaussian's axes a in the world."""
    axes = [turn(quaternion, axis) for axis in np.eye(3)]
    return sum(s**2 * np.outer(axis, axis) for s, axis in zip(scales, axes, strict=True))


def test_covariances_and_centres_agree_with_the_oracle() -> None:
    scene = make(np.random.default_rng(1).uniform(0.004, 0.02, (300, 3)))
    splats = to_splats(scene)
    expected = [
        covariance(s.astype(np.float64), q.astype(np.float64))
        for s, q in zip(scene.scales, scene.rotations, strict=True)
    ]
    ours = splats.covariances.astype(np.float64) * splats.scale**2
    # float32, and quaternions that float32 gives a length of 1 to 1e-7
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-6 * np.abs(expected).max())
    np.testing.assert_allclose(splats.centers * splats.scale, scene.means, atol=1e-6)


def test_half_floats_are_precise_at_any_scene_size() -> None:
    scales = np.random.default_rng(2).uniform(0.5, 2, (200, 3))
    for size in (1e-5, 1.0, 1e4):
        splats = to_splats(make(scales * size))
        sent = splats.covariances.astype(np.float16).astype(np.float64)
        largest = splats.covariances.max(axis=(1, 2))[:, None, None]
        assert (np.abs(sent - splats.covariances) <= 2.0**-11 * largest).all()


@settings(max_examples=60, deadline=None)
@given(
    exponents=st.lists(st.tuples(*[st.floats(-5, 5)] * 3), min_size=1, max_size=20),
    seed=st.integers(0, 2**32 - 1),
)
def test_no_splat_is_lost_to_rounding(exponents: list[tuple[float, ...]], seed: int) -> None:
    splats = to_splats(make(10.0 ** np.array(exponents), seed))
    sent = splats.covariances.astype(np.float16).astype(np.float64)
    assert np.isfinite(sent).all()
    size = np.trace(sent, axis1=1, axis2=2)
    smallest = np.linalg.eigvalsh(sent)[:, 0]
    # Below this, half floats have steps of their own; such a splat is a point on the screen.
    assert (smallest[size >= 1e-2] >= 0).all()


def test_needles_and_giants_are_sent_as_far_as_they_can_be() -> None:
    scales = np.full((101, 3), 0.01)
    scales[0] = [0.1, 1e-6, 1e-6]
    scales[1] = 1e5
    splats = to_splats(make(scales))
    lengths = np.sqrt(np.linalg.eigvalsh(splats.covariances[:2].astype(np.float64))) * splats.scale
    np.testing.assert_allclose(lengths[0], [0.1 * THINNEST, 0.1 * THINNEST, 0.1], rtol=1e-3)
    np.testing.assert_allclose(lengths[1], LARGEST * 0.01, rtol=1e-5)


def test_colours_and_opacities_are_the_nearest_bytes() -> None:
    scene = make(np.full((500, 3), 0.01))
    splats = to_splats(scene)
    assert splats.opacities.shape == (500, 1)
    assert splats.rgbs.min() == 0
    assert splats.rgbs.max() == 255
    clipped = scene.colours.clip(0, 1)
    assert np.abs(splats.rgbs / 255 - clipped).max() <= 0.5 / 255 + 1e-6
    assert np.abs(splats.opacities[:, 0] / 255 - scene.opacities).max() <= 0.5 / 255 + 1e-6


@pytest.mark.parametrize("size", [0.0, 1e-30])
def test_points_without_size_are_finite(size: float) -> None:
    splats = to_splats(make(np.full((4, 3), size)))
    assert np.isfinite(splats.centers).all()
    assert np.isfinite(splats.covariances.astype(np.float16)).all()


def test_sharp_gaussians_are_large_enough_for_viser_to_draw_them() -> None:
    """Viser's shader: opacity times the determinant on the screen, dilated by 0.3, from 0.25."""
    scene = make(np.full((200, 3), 1e-6))
    view = View(np.array([0.1, 0.2, -5.0]), np.zeros(3), np.array([0.0, -1.0, 0.0]), 0.8, 5.0)
    splats = to_splats(scene, least_scales(scene, view))
    covariances = splats.covariances.astype(np.float16).astype(np.float64) * splats.scale**2
    kept = []
    for mean, matrix in zip(scene.means.astype(np.float64), covariances, strict=True):
        towards = mean - view.position
        across = np.linalg.svd(towards[None])[2][1:]  # two axes perpendicular to the line of sight
        focal = ROWS / 2 / np.tan(view.fov / 2) / (AWAY * np.linalg.norm(towards))
        on_screen = focal**2 * across @ matrix @ across.T + 0.3 * np.eye(2)
        kept.append(np.linalg.det(on_screen))
    seen = splats.opacities[:, 0] / 255 * np.array(kept)
    drawn = scene.opacities >= FAINTEST
    assert (seen[drawn] > 0.25 * 0.99).all()
    assert (seen[drawn] < 0.26).all()  # and no larger


def test_gaussians_that_are_large_enough_stay_as_they_are() -> None:
    scene = make(np.random.default_rng(4).uniform(0.1, 0.2, (50, 3)))
    view = View(np.array([0.0, 0.0, -5.0]), np.zeros(3), np.array([0.0, -1.0, 0.0]), 0.8, 5.0)
    plain, kept = to_splats(scene), to_splats(scene, least_scales(scene, view))
    np.testing.assert_array_equal(plain.covariances, kept.covariances)
