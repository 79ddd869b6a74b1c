"""Traces: the renderer's own picture, as a matrix."""

from __future__ import annotations

import numpy as np
import pytest

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.fitting.shares import SMALLEST_SHARE
from styl3r_cli.fitting.tracing import trace
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.splatting import render
from styl3r_cli.splatting.projection import near_plane


def fog(count: int = 400) -> Gaussians:
    """Faint, wide Gaussians: many shares a pixel."""
    random = np.random.default_rng(3)
    return Gaussians(
        random.uniform([-1, -1, 1], [1, 1, 3], (count, 3)),
        random.uniform(0.1, 0.5, (count, 3)),
        random.normal(size=(count, 4)),
        random.uniform(0.02, 0.3, count),
        random.uniform(0, 1, (count, 3)),
    )


@pytest.mark.parametrize("foggy", [False, True])
def test_its_picture_is_the_renderers(scene: Gaussians, cameras: list[Camera], foggy: bool) -> None:
    drawn = fog() if foggy else scene
    for camera in cameras:
        frame = render(drawn, camera)
        seen = trace(drawn, camera, near_plane(drawn.means))
        np.testing.assert_allclose(
            seen.picture.reshape(frame.colour.shape), frame.colour, atol=2e-5
        )
        np.testing.assert_allclose(
            1 - seen.through.reshape(frame.alpha.shape), frame.alpha, atol=2e-5
        )


def test_its_matrix_draws_other_colours_too(scene: Gaussians, cameras: list[Camera]) -> None:
    other = scene.with_colours(np.random.default_rng(0).random((len(scene), 3)))
    seen = trace(scene, cameras[0], near_plane(scene.means))
    frame = render(other, cameras[0])
    # Shares that are left out are small, and few of them lie on one pixel of a surface.
    drawn = seen.draw(other.colours).reshape(frame.colour.shape)
    assert np.abs(drawn - frame.colour).max() < 20 * SMALLEST_SHARE


def test_gathering_is_the_transpose_of_drawing(scene: Gaussians, cameras: list[Camera]) -> None:
    random = np.random.default_rng(1)
    seen = trace(scene, cameras[1], near_plane(scene.means))
    colours = random.random((len(scene), 3)).astype(np.float32)
    values = random.random(seen.picture.shape).astype(np.float32)
    there = np.vdot(seen.draw(colours).astype(np.float64), values)
    back = np.vdot(colours, seen.gather(values).astype(np.float64))
    assert there == pytest.approx(back, rel=1e-5)


def test_shares_of_a_pixel_and_what_comes_through_make_one(
    scene: Gaussians, cameras: list[Camera]
) -> None:
    seen = trace(scene, cameras[0], near_plane(scene.means))
    white = np.ones((len(scene), 3), np.float32)
    sums = seen.draw(white)[:, 0] + seen.through
    np.testing.assert_allclose(sums, 1, atol=20 * SMALLEST_SHARE)
    total, largest = seen.seen()
    assert total.sum() == pytest.approx(seen.shares.sum(), rel=1e-5)
    assert largest.max() == seen.shares.max()
