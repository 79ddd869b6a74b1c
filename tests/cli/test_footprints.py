"""Scenes without gaps between a view's Gaussians, in frames of any size."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.footprints import LEAST_SCALE, without_gaps
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.painter import Painter
from styl3r_cli.picture_metrics import psnr
from styl3r_cli.pipeline import Scene, Stylizer, assemble
from styl3r_cli.splatting import render

SIDE, FOCAL, DEPTH = 32, 40.0, 2.0
POINT = 0.25  # standard deviation of the network's Gaussians, pixels
ZOOM = 4  # a window of 1024 pixels, where photos have 256


@pytest.fixture
def scene() -> Scene:
    """One view of a wall that leans away, a point a pixel, and the same view again, lost."""
    grid = (np.arange(SIDE) + 0.5 - SIDE / 2) / FOCAL
    x, y = np.meshgrid(grid, grid)
    depth = DEPTH * (1 + 0.5 * x)
    wall = np.stack((x * depth, y * depth, depth), -1)
    means = np.stack((wall, wall)).astype(np.float32)
    shape = means.shape[:3]
    scales = np.broadcast_to(POINT / FOCAL * means[..., 2:], (*shape, 3))
    return Scene(
        images=np.full((2, 3, SIDE, SIDE), 0.5, np.float32),
        intrinsics=np.tile(np.eye(3, dtype=np.float32), (2, 1, 1)),
        means=means,
        scales=scales.astype(np.float32),
        rotations=np.tile(np.array([1, 0, 0, 0], np.float32), (*shape, 1)),
        opacities=np.full(shape, 0.8, np.float32),
        content_tokens=np.zeros((2, 4, 8), np.float32),
    )


@pytest.fixture
def recovered() -> Recovered:
    camera = Camera(np.eye(4), FOCAL, FOCAL, SIDE / 2, SIDE / 2, SIDE, SIDE)
    return Recovered([camera, camera], [1.0, 0.0], [True, False], None, None, [])


def first_view(scene: Scene) -> Gaussians:
    """Its Gaussians, smooth waves in colour."""
    phases = 3 * scene.means[0]
    colours = (0.5 + 0.4 * np.sin(phases)).astype(np.float32)
    everything, _ = assemble(scene, np.stack((colours, colours)))
    return everything.select(np.arange(SIDE * SIDE))


def test_frames_of_more_pixels_have_no_holes(scene: Scene, recovered: Recovered) -> None:
    camera = recovered.cameras[0].resized(ZOOM * SIDE, ZOOM * SIDE)
    inside = np.s_[3 * ZOOM : -3 * ZOOM, 3 * ZOOM : -3 * ZOOM]
    for antialias in (False, True):  # as viewers do that fade what is smaller than a pixel
        points, closed = (
            render(first_view(each), camera, threads=1, antialias=antialias).alpha[inside]
            for each in (scene, without_gaps(scene, recovered))
        )
        assert points.min() < 0.2  # or this would test nothing
        assert closed.min() > 0.7


def test_large_frames_agree_with_small_ones(scene: Scene, recovered: Recovered) -> None:
    camera = recovered.cameras[0]
    large = camera.resized(ZOOM * SIDE, ZOOM * SIDE)
    agreement = []
    for each in (scene, without_gaps(scene, recovered)):
        gaussians = first_view(each)
        frame = render(gaussians, large, threads=1).colour
        halved = frame.reshape(SIDE, ZOOM, SIDE, ZOOM, 3).mean((1, 3))
        agreement.append(psnr(halved, render(gaussians, camera, threads=1).colour))
    assert agreement[1] > agreement[0] + 10  # decibels


def test_nothing_becomes_narrower_and_what_is_wide_stays(
    scene: Scene, recovered: Recovered
) -> None:
    scene.scales[0, 3, 4] = 1.5 * scene.means[0, 3, 4, 2] / FOCAL, 1e-6, 1e-6
    after = without_gaps(scene, recovered).scales
    pixels = after[0] / scene.means[0, ..., 2:] * FOCAL
    np.testing.assert_allclose(pixels.min(), LEAST_SCALE, rtol=1e-5)
    np.testing.assert_allclose(pixels[3, 4], (1.5, LEAST_SCALE, LEAST_SCALE), rtol=1e-5)


def test_a_view_without_a_camera_stays_as_it_is(scene: Scene, recovered: Recovered) -> None:
    after = without_gaps(scene, recovered)
    np.testing.assert_array_equal(after.scales[1], scene.scales[1])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1.0])
def test_impossible_points_change_nothing(scene: Scene, recovered: Recovered, value: float) -> None:
    scene.means[0, 5, 6] = value
    after = without_gaps(scene, recovered).scales
    assert not np.isnan(after).any()
    assert (after >= scene.scales).all()
    everything, repairs = assemble(replace(scene, scales=after), np.ones_like(scene.means))
    assert repairs.dropped_not_finite == (0 if value == -1 else 1)
    assert np.isfinite(everything.scales).all()


@pytest.mark.parametrize(("paints_pictures", "least"), [(True, LEAST_SCALE), (False, POINT)])
def test_painters_close_gaps_but_leave_what_was_trained_in_a_renderer(
    scene: Scene, recovered: Recovered, paints_pictures: bool, least: float
) -> None:
    colours = np.full_like(scene.means, 0.5)
    brush: Any = SimpleNamespace(
        model=SimpleNamespace(paints_pictures=paints_pictures), colours=lambda *_, **__: colours
    )
    gaussians, _ = Painter(cast(Stylizer, brush), scene, recovered, 1)()
    first = gaussians.select(np.arange(SIDE * SIDE))
    np.testing.assert_allclose(first.scales.min() / first.means[:, 2].min() * FOCAL, least, 1e-4)
