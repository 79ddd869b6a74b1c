"""Depths become right where views overlap, and stay where nothing confirms others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from wavy_wall import SIDE, wall

from styl3r_cli.cameras.matches import as_pictures
from styl3r_cli.cameras.poses import centre
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.pipeline import Scene
from styl3r_cli.stereo.dense import dense
from styl3r_cli.stereo.sweep import View, find_nearness, motion

Field = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


def with_depths(scene: Scene, recovered: Recovered, factor: Field) -> Scene:
    """The scene with depths times factors over the picture, x and y from 0 to 1."""
    grid = np.linspace(0, 1, SIDE)
    factors = factor(*np.meshgrid(grid, grid))[..., None]
    means = scene.means.copy()
    for view, camera in enumerate(recovered.cameras):
        eye = centre(camera.extrinsics)
        means[view] = eye + (scene.means[view] - eye) * factors
    return replace(scene, means=means)


def bumps(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    return 1 + 0.12 * np.sin(14 * x) * np.cos(11 * y)


def errors(scene: Scene, true: Scene, recovered: Recovered) -> list[NDArray[np.float64]]:
    """By which part each view's depths are off."""
    found = []
    for view, camera in enumerate(recovered.cameras):
        eye = centre(camera.extrinsics)
        away = [np.linalg.norm(each.means[view] - eye, axis=-1) for each in (scene, true)]
        found.append(np.abs(away[0] / away[1] - 1))
    return found


def run(scene: Scene, recovered: Recovered, threads: int | None = 1) -> Scene:
    return dense(scene, recovered, as_pictures(scene.images), threads)


@pytest.mark.parametrize("views", [2, 3, 5])
def test_depths_become_right_where_views_overlap(views: int) -> None:
    true, recovered = wall(views)
    wrong = with_depths(true, recovered, bumps)
    made = run(wrong, recovered)
    for before, after in zip(
        errors(wrong, true, recovered), errors(made, true, recovered), strict=True
    ):
        assert np.median(before) > 0.03
        assert np.median(after) < 0.004
        assert (after > before + 0.02).mean() < 0.05
    # Gaussians stay on their rays, and their sizes go with their depths.
    for view, camera in enumerate(recovered.cameras):
        eye = centre(camera.extrinsics)
        away = [np.linalg.norm(each.means[view] - eye, axis=-1) for each in (made, wrong)]
        rays = [
            (each.means[view] - eye) / far[..., None]
            for each, far in zip((made, wrong), away, strict=True)
        ]
        np.testing.assert_allclose(rays[0], rays[1], atol=1e-5)
        grown = np.repeat((away[0] / away[1])[..., None], 3, axis=-1)
        np.testing.assert_allclose(made.scales[view] / wrong.scales[view], grown, rtol=1e-4)
    np.testing.assert_array_equal(made.opacities, wrong.opacities)


def test_depths_that_are_right_stay_so() -> None:
    true, recovered = wall(3)
    for after in errors(run(true, recovered), true, recovered):
        assert np.median(after) < 0.004


def test_pictures_in_more_detail_serve_as_well() -> None:
    true, recovered = wall(2)
    wrong = with_depths(true, recovered, bumps)
    large = [cv2.resize(each, (300, 260)) for each in as_pictures(true.images)]
    for after in errors(dense(wrong, recovered, large), true, recovered):
        assert np.median(after) < 0.01


def test_nothing_is_told_from_walls_without_texture() -> None:
    true, recovered = wall(2)
    plain = replace(true, images=np.full_like(true.images, 0.5))
    wrong = with_depths(plain, recovered, bumps)
    for before, after in zip(
        errors(wrong, true, recovered), errors(run(wrong, recovered), true, recovered), strict=True
    ):
        assert after.mean() < before.mean() + 0.02


def test_cameras_that_are_wrong_confirm_nothing() -> None:
    true, recovered = wall(2)
    turn = np.eye(4)
    turn[:3, :3] = cv2.Rodrigues(np.array([0.5, -0.3, 0.4]))[0]
    lost = replace(recovered.cameras[1], extrinsics=turn @ recovered.cameras[1].extrinsics)
    astray = replace(recovered, cameras=[recovered.cameras[0], lost])
    made = run(true, astray)
    np.testing.assert_array_equal(made.means, true.means)
    np.testing.assert_array_equal(made.scales, true.scales)


def test_one_view_that_stands_alone_stays() -> None:
    true, recovered = wall(3)
    wrong = with_depths(true, recovered, bumps)
    alone = replace(recovered, recovered=[True, True, False])
    made = run(wrong, alone)
    np.testing.assert_array_equal(made.means[2], wrong.means[2])
    assert np.abs(made.means[0] - wrong.means[0]).max() > 0.01
    nobody = replace(recovered, recovered=[False, True, False])
    np.testing.assert_array_equal(run(wrong, nobody).means, wrong.means)


def with_poster(scene: Scene, recovered: Recovered, views: list[int]) -> NDArray[np.bool_]:
    """Paint a near poster into some views' pictures only; (N, H, W) where it is."""
    texture = np.random.default_rng(8).uniform(0, 1, (24, 24, 3)).astype(np.float32)
    texture = cv2.resize(texture, (240, 240), interpolation=cv2.INTER_CUBIC)
    corners = np.array([[0.2, -0.2], [0.6, -0.2], [0.6, 0.2], [0.2, 0.2]])
    world = np.column_stack([corners, np.full(4, 1.5)])
    there = np.zeros(scene.opacities.shape, np.bool_)
    for view in views:
        camera = recovered.cameras[view]
        seen = world @ camera.extrinsics[:3, :3].T + camera.extrinsics[:3, 3]
        pixels = seen @ camera.intrinsics.T
        places = (pixels[:, :2] / pixels[:, 2:] - 0.5).astype(np.float32)
        flat = np.array([[0, 0], [240, 0], [240, 240], [0, 240]], np.float32)
        matrix = cv2.getPerspectiveTransform(flat, places)
        poster = cv2.warpPerspective(texture, matrix, (SIDE, SIDE))
        there[view] = cv2.warpPerspective(np.ones((240, 240), np.float32), matrix, (SIDE, SIDE)) > 0
        scene.images[view] = np.where(
            there[view], poster.clip(0, 1).transpose(2, 0, 1), scene.images[view]
        )
    return there


def test_what_more_views_look_through_than_see_is_not_taken() -> None:
    true, recovered = wall(5)
    there = with_poster(true, recovered, [2, 3])
    assert there[2].sum() > 1000
    among_five = errors(run(true, recovered), true, recovered)
    assert np.median(among_five[2][there[2]]) < 0.02
    # For all that the two know by themselves it hangs there.
    alone = replace(recovered, recovered=[False, False, True, True, False])
    assert np.median(errors(run(true, alone), true, recovered)[2][there[2]]) > 0.15


def test_threads_change_nothing() -> None:
    true, recovered = wall(3)
    wrong = with_depths(true, recovered, bumps)
    one, two = (run(wrong, recovered, threads) for threads in (1, 2))
    np.testing.assert_array_equal(one.means, two.means)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, -1e30])
def test_points_that_are_nowhere_harm_nobody(value: float) -> None:
    true, recovered = wall(2)
    wrong = with_depths(true, recovered, bumps)
    wrong.means[:, 60:80, 60:80] = value
    made = run(wrong, recovered)
    away = np.ones((SIDE, SIDE), np.bool_)
    away[60:80, 60:80] = False
    for after in errors(made, true, recovered):
        assert np.median(after[away]) < 0.005
    nowhere = replace(wrong, means=np.full_like(wrong.means, value))
    np.testing.assert_array_equal(run(nowhere, recovered).means, nowhere.means)


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_the_unit_of_length_does_not_matter(unit: float) -> None:
    true, recovered = wall(2)
    wrong = with_depths(true, recovered, bumps)
    cameras = []
    for camera in recovered.cameras:
        pose = camera.extrinsics.copy()
        pose[:3, 3] *= unit
        cameras.append(replace(camera, extrinsics=pose))
    scaled = replace(wrong, means=(wrong.means * np.float32(unit)))
    made = run(scaled, replace(recovered, cameras=cameras))
    plain = run(wrong, recovered)
    off = np.abs(made.means / np.float32(unit) - plain.means).max(axis=-1)
    assert (off < 1e-3).mean() > 0.99  # rounding decides a few labels


def test_cameras_that_only_turned_tell_nothing() -> None:
    true, recovered = wall(2)
    first = recovered.cameras[0]
    turned = first.extrinsics.copy()
    turned[:3, :3] = cv2.Rodrigues(np.array([0, 0.1, 0]))[0]
    other = replace(first, extrinsics=turned)
    pictures = as_pictures(true.images)
    known = 1 / true.means[0, ..., 2].astype(np.float64)
    view = View(pictures[0], first, known)
    assert find_nearness(view, [View(pictures[1], other, known)]) is None
    unknown = View(pictures[0], first, np.full_like(known, np.nan))
    beside = View(pictures[1], recovered.cameras[1], known)
    assert find_nearness(unknown, [beside]) is None
    assert find_nearness(view, [beside]) is not None


def test_motion_is_the_parallax_of_the_view_that_moved_most() -> None:
    first = wall(1)[1].cameras[0]
    near, far = first.extrinsics.copy(), first.extrinsics.copy()
    near[0, 3], far[0, 3] = -0.1, -0.3
    aside = [replace(first, extrinsics=pose) for pose in (near, far)]
    expected = 0.3 * first.fx * (1 / 2 - 1 / 4)
    assert motion(first, aside, 1 / 4, 1 / 2) == pytest.approx(expected)
    behind = first.extrinsics.copy()
    behind[2, 3] = -100.0
    assert motion(first, [replace(first, extrinsics=behind)], 1 / 4, 1 / 2) == 0
