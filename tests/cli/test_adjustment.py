"""Views that are a little off come together as their features meet; right ones stay."""

from __future__ import annotations

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from wavy_wall import SIDE, match_images, wall

from styl3r_cli.adjustment import adjusted
from styl3r_cli.cameras.pose_errors import direction_error, motion, rotation_error
from styl3r_cli.cameras.poses import centre
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.pipeline import Scene


def blurred(scene: Scene, recovered: Recovered, size: float = 1.0) -> tuple[Scene, Recovered]:
    """Cameras a degree and more off, with all that they see; depths that are bent by up to 8 %."""
    means, cameras = scene.means.astype(np.float64), list(recovered.cameras)
    random = np.random.default_rng(0)
    x, y = np.meshgrid(*[np.linspace(-1, 1, SIDE)] * 2)
    for view, camera in enumerate(cameras):
        bend = 1 + 0.03 * x - 0.02 * y * x + 0.03 * (-1) ** view
        eye = centre(camera.extrinsics)
        means[view] = eye + (means[view] - eye) * bend[..., None]
        if view:
            off = np.eye(4)
            off[:3, :3] = cv2.Rodrigues(random.normal(size=3) * np.radians(1))[0]
            off[:3, 3] = random.normal(size=3) * 0.02
            wrong = off @ camera.extrinsics
            back = np.linalg.inv(wrong) @ camera.extrinsics
            means[view] = means[view] @ back[:3, :3].T + back[:3, 3]
            camera = replace(camera, extrinsics=wrong)
        extrinsics = camera.extrinsics.copy()
        extrinsics[:3, 3] *= size
        cameras[view] = replace(camera, extrinsics=extrinsics)
    made = replace(
        scene,
        means=(means * size).astype(np.float32),
        scales=(scene.scales * size).astype(np.float32),
    )
    return made, replace(recovered, cameras=cameras)


def errors(found: Recovered, true: Recovered) -> list[float]:
    """Degrees between every camera and the first, as they are and as they should be."""
    pairs = [
        [motion(r.cameras[0].extrinsics, r.cameras[view].extrinsics) for r in (found, true)]
        for view in range(1, len(true.cameras))
    ]
    return [max(rotation_error(*pair), direction_error(*pair)) for pair in pairs]


def depth_error(made: Scene, found: Recovered, scene: Scene, true: Recovered) -> float:
    """Mean of all views' relative errors, after one scale for all."""
    depths = []
    for one, r in ((made, found), (scene, true)):
        rows = [camera.extrinsics[2] for camera in r.cameras]
        depths.append([p @ row[:3] + row[3] for p, row in zip(one.means, rows, strict=True)])
    ratio = np.array(depths[0]) / np.array(depths[1])
    return float(np.abs(ratio / np.median(ratio) - 1).mean())


@pytest.mark.parametrize("views", [2, 3, 4])
def test_cameras_and_depths_come_nearer(views: int) -> None:
    scene, true = wall(views)
    wrong, there = blurred(scene, true)
    assert max(errors(there, true)) > 2
    before = depth_error(wrong, there, scene, true)
    assert before > 0.02
    made, found = adjusted(wrong, there, match_images(wrong.images))
    assert max(errors(found, true)) < 0.5
    assert depth_error(made, found, scene, true) < 0.2 * before
    np.testing.assert_array_equal(found.cameras[0].extrinsics, there.cameras[0].extrinsics)
    np.testing.assert_array_equal(made.opacities, wrong.opacities)
    # Each view's points stay on its camera's rays, and their sizes go with their depths.
    assert min(found.inlier_ratios) > 0.99
    for view in range(views):
        away = [
            np.linalg.norm(each.means[view] - centre(r.cameras[view].extrinsics), axis=-1)
            for each, r in ((made, found), (wrong, there))
        ]
        grown = np.repeat((away[0] / away[1])[..., None], 3, axis=-1)
        np.testing.assert_allclose(made.scales[view] / wrong.scales[view], grown, rtol=1e-3)


def through(scene: Scene, recovered: Recovered, lens: float) -> tuple[Scene, Recovered]:
    """What a network makes of photos whose focal length is taken for so many times what it is."""
    means, cameras = scene.means.astype(np.float64), []
    for view, camera in enumerate(recovered.cameras):
        turn, shift = camera.extrinsics[:3, :3], camera.extrinsics[:3, 3]
        seen = means[view] @ turn.T + shift
        means[view] = (seen / [lens, lens, 1] - shift) @ turn
        cameras.append(replace(camera, fx=camera.fx * lens, fy=camera.fy * lens))
    scales = (scene.scales / lens).astype(np.float32)
    made = replace(scene, means=means.astype(np.float32), scales=scales)
    return made, replace(recovered, cameras=cameras, focal=cameras[0].fx)


@pytest.mark.parametrize("lens", [0.85, 1.2])
def test_a_lens_that_was_guessed_becomes_right(lens: float) -> None:
    scene, true = wall(4)
    wrong, there = through(scene, true, lens)
    matches = match_images(scene.images)
    made, found = adjusted(wrong, there, matches, any_lens=True)
    for camera, right in zip(found.cameras, true.cameras, strict=True):
        assert camera.fx == pytest.approx(right.fx, rel=0.03)
        assert camera.fy == pytest.approx(right.fy, rel=0.03)
    assert found.focal == pytest.approx(found.cameras[0].fx)
    assert max(errors(found, true)) < 1
    assert min(found.inlier_ratios) > 0.99
    assert depth_error(made, found, scene, true) < 0.02
    (note,) = found.notes
    told = re.fullmatch(r"features .* fit ([\d.]+) times the focal length .*", note)
    assert told is not None
    assert float(told[1]) == pytest.approx(1 / lens, rel=0.03)
    _, kept = adjusted(wrong, there, matches)
    assert [camera.fx for camera in kept.cameras] == [camera.fx for camera in there.cameras]


def test_what_is_right_stays_as_it_is() -> None:
    scene, recovered = wall(3)
    made, found = adjusted(scene, recovered, match_images(scene.images))
    assert made is scene
    assert found is recovered


def test_without_features_everything_stays() -> None:
    scene, recovered = blurred(*wall(2))
    other, _ = wall(2, seed=1)
    for images in (np.full_like(scene.images, 0.5), np.stack([scene.images[0], other.images[1]])):
        there = replace(scene, images=images)
        made, found = adjusted(there, recovered, match_images(images))
        assert made is there
        assert found is recovered


def test_views_whose_camera_is_not_known_stay() -> None:
    scene, true = wall(3)
    wrong, there = blurred(scene, true)
    there = replace(there, recovered=[True, True, False])
    made, found = adjusted(wrong, there, match_images(wrong.images))
    np.testing.assert_array_equal(made.means[2], wrong.means[2])
    np.testing.assert_array_equal(found.cameras[2].extrinsics, there.cameras[2].extrinsics)
    assert errors(found, true)[0] < 0.5 < errors(there, true)[0]


def test_one_known_view_stays() -> None:
    scene, recovered = blurred(*wall(2))
    recovered = replace(recovered, recovered=[True, False])
    assert adjusted(scene, recovered, match_images(scene.images)) == (scene, recovered)


@pytest.mark.parametrize("size", [1e-6, 1e6])
def test_the_unit_of_length_plays_no_part(size: float) -> None:
    scene, true = wall(3)
    matches = match_images(scene.images)
    one, far = (adjusted(*blurred(scene, true, each), matches) for each in (1.0, size))
    np.testing.assert_allclose(far[0].means / size, one[0].means, atol=2e-3)
    assert max(errors(far[1], one[1])) < 0.02


def test_points_that_are_not_finite_do_not_decide() -> None:
    scene, true = wall(2)
    wrong, there = blurred(scene, true)
    wrong.means[1, ::5] = np.nan
    wrong.means[0, :, ::7] = np.inf
    wrong.means[0, 3::9] = 0  # in the camera itself
    made, found = adjusted(wrong, there, match_images(wrong.images))
    assert max(errors(found, true)) < 0.6
    np.testing.assert_array_equal(np.isfinite(made.means), np.isfinite(wrong.means))


@pytest.mark.parametrize("nothing", [np.nan, 0.0, -1.0])
def test_scenes_that_are_none_pass(nothing: float) -> None:
    scene, recovered = blurred(*wall(2))
    there = replace(scene, means=np.full_like(scene.means, nothing))
    made, found = adjusted(there, recovered, match_images(scene.images))
    np.testing.assert_array_equal(np.isfinite(made.means), np.isfinite(there.means))
    for camera in found.cameras:
        turn = camera.extrinsics[:3, :3]
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-6)


def test_cameras_in_one_place_stay() -> None:
    """A turn alone: there is no unit of length, and no depth to find."""
    scene, recovered = wall(2)
    turned = recovered.cameras[1].extrinsics.copy()
    turned[:3, 3] = 0
    there = replace(
        recovered,
        cameras=[recovered.cameras[0], replace(recovered.cameras[1], extrinsics=turned)],
    )
    assert adjusted(scene, there, match_images(scene.images)) == (scene, there)
