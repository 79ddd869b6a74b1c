"""Cameras from point maps of known cameras: exact, noisy, full of outliers, degenerate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.recover import Recovered, recover

HEIGHT, WIDTH = 96, 128
Maps = NDArray[np.float32]


def true_cameras(count: int, focal: float = 120.0) -> list[Camera]:
    """The first at the origin, the others beside it, turned inwards."""
    cameras = []
    for view in range(count):
        pose = np.eye(4)
        turn = [0.06 * view, -0.15 * view, 0.04 * view]
        pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
        pose[:3, 3] = -pose[:3, :3] @ [0.5 * view, 0.1 * view, -0.05 * view]
        cameras.append(Camera(pose, focal, focal, WIDTH / 2, HEIGHT / 2, WIDTH, HEIGHT))
    return cameras


def point_map(camera: Camera, seed: int) -> NDArray[np.float64]:
    """(H, W, 3) world points: a bumpy surface, 2 to 6 units in front of the camera."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    phase = np.random.default_rng(seed).uniform(0, 6, 2)
    depth = 4 + np.sin(x / 17 + phase[0]) + np.cos(y / 13 + phase[1])
    rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], -1)
    return (rays * depth[..., None] - camera.extrinsics[:3, 3]) @ camera.extrinsics[:3, :3]


def maps(cameras: list[Camera], noise: float = 0.0, outliers: float = 0.0) -> tuple[Maps, Maps]:
    rng = np.random.default_rng(7)
    points = np.stack([point_map(camera, view) for view, camera in enumerate(cameras)])
    points += rng.normal(scale=noise, size=points.shape) if noise else 0
    wild = rng.random(points.shape[:3]) < outliers
    wild[0] = False  # the first view gives the focal length
    points[wild] = rng.uniform([-5, -4, 1], [5, 4, 8], (int(wild.sum()), 3))
    return points.astype(np.float32), np.full(points.shape[:3], 0.8, np.float32)


def normalised(cameras: list[Camera]) -> Maps:
    return np.stack([c.intrinsics / [[WIDTH], [HEIGHT], [1]] for c in cameras]).astype(np.float32)


def degrees_and_distance(found: Camera, true: Camera) -> tuple[float, float]:
    step = found.extrinsics @ np.linalg.inv(true.extrinsics)
    angle = np.degrees(Rotation.from_matrix(step[:3, :3]).magnitude())
    centres = [np.linalg.inv(camera.extrinsics)[:3, 3] for camera in (found, true)]
    return float(angle), float(np.linalg.norm(centres[0] - centres[1]))


def assert_close(result: Recovered, cameras: list[Camera], angle: float, distance: float) -> None:
    for found, true in zip(result.cameras, cameras, strict=True):
        off = degrees_and_distance(found, true)
        assert off[0] < angle
        assert off[1] < distance


def test_exact_maps_give_the_cameras_back() -> None:
    cameras = true_cameras(4)
    result = recover(*maps(cameras))
    assert result.focal == pytest.approx(120.0, rel=1e-5)
    assert result.focal_given is None
    assert_close(result, cameras, 1e-3, 1e-4)
    assert result.inlier_ratios == pytest.approx([1.0] * 4)
    assert result.recovered == [True] * 4
    assert result.notes == []
    np.testing.assert_array_equal(result.cameras[0].extrinsics, np.eye(4))
    assert {(c.width, c.height) for c in result.cameras} == {(WIDTH, HEIGHT)}


def test_rotations_are_rotations_and_not_mirrors() -> None:
    for camera in recover(*maps(true_cameras(3), noise=0.05)).cameras:
        rotation = camera.extrinsics[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(rotation) == pytest.approx(1)


@pytest.mark.parametrize("outliers", [0.0, 0.3, 0.6])
def test_noise_and_outliers(outliers: float) -> None:
    """Noise of 0.01 at a distance of 4 is 0.3 pixels."""
    cameras = true_cameras(3)
    result = recover(*maps(cameras, noise=0.01, outliers=outliers))
    assert_close(result, cameras, 0.3, 0.02)
    for ratio in result.inlier_ratios[1:]:
        assert ratio == pytest.approx(1 - outliers, abs=0.1)


@pytest.mark.parametrize("outliers", [0.3, 0.6])
def test_focal_length_despite_outliers_in_the_first_view(outliers: float) -> None:
    points, opacities = maps(true_cameras(2))
    wild = np.random.default_rng(1).random(points.shape[1:3]) < outliers
    points[0][wild] = np.random.default_rng(2).uniform(-5, 5, (int(wild.sum()), 3))
    assert recover(points, opacities).focal == pytest.approx(120.0, rel=0.02)


def test_transparent_points_do_not_count() -> None:
    cameras = true_cameras(2)
    points, opacities = maps(cameras)
    wild = np.random.default_rng(1).random(points.shape[:3]) < 0.8
    points[wild] = np.random.default_rng(2).uniform(-5, 5, (int(wild.sum()), 3))
    opacities[wild] = 0
    result = recover(points, opacities)
    assert_close(result, cameras, 1e-2, 1e-3)
    assert result.inlier_ratios == pytest.approx([1.0, 1.0])


def test_poor_maps_get_the_wide_threshold() -> None:
    """Noise of 5 pixels leaves a fifth of the points within the narrow threshold."""
    cameras = true_cameras(2)
    points, opacities = maps(cameras, noise=0.12)
    result = recover(points, opacities, normalised(cameras), [True, True])
    assert result.recovered == [True, True]
    assert_close(result, cameras, 1.0, 0.1)


def test_measured_focal_lengths_are_kept_and_guesses_corrected() -> None:
    cameras = true_cameras(3)
    points, opacities = maps(cameras)
    wrong = [replace(camera, fx=100.0, fy=100.0) for camera in cameras]
    kept = recover(points, opacities, normalised(wrong), [True, True, False])
    assert [camera.fx for camera in kept.cameras] == pytest.approx([100, 100, 120], rel=1e-4)
    assert kept.focal_given == pytest.approx(100, rel=1e-6)
    corrected = recover(points, opacities, normalised(wrong))
    assert [camera.fy for camera in corrected.cameras] == pytest.approx([120] * 3, rel=1e-4)
    assert_close(corrected, cameras, 1e-2, 1e-3)


def test_zoom_between_views_survives_the_correction() -> None:
    cameras = true_cameras(2)
    cameras[1] = replace(cameras[1], fx=180.0, fy=180.0)
    given = [replace(camera, fx=camera.fx * 0.8, fy=camera.fy * 0.8) for camera in cameras]
    result = recover(*maps(cameras), normalised(given))
    assert [camera.fx for camera in result.cameras] == pytest.approx([120, 180], rel=1e-4)
    assert_close(result, cameras, 1e-2, 1e-3)


def test_off_centre_principal_points_and_oblong_pixels() -> None:
    cameras = [replace(c, cx=70.0, cy=40.0, fy=c.fx * 1.1) for c in true_cameras(2)]
    result = recover(*maps(cameras), normalised(cameras))
    assert result.focal == pytest.approx(120.0, rel=1e-4)
    assert_close(result, cameras, 1e-2, 1e-3)


def test_disagreement_on_the_field_of_view_is_noted() -> None:
    cameras = true_cameras(2)
    wrong = [replace(camera, fx=60.0, fy=60.0) for camera in cameras]
    notes = recover(*maps(cameras), normalised(wrong), [True, True]).notes
    assert any("suggest a field of view of 56 degrees across, its photo 94" in n for n in notes)


@pytest.mark.parametrize("factor", [1e-4, 1e4])
def test_any_scene_scale(factor: float) -> None:
    cameras = true_cameras(2)
    points, opacities = maps(cameras)
    result = recover((points * factor).astype(np.float32), opacities)
    angle, distance = degrees_and_distance(
        result.cameras[1], replace(cameras[1], extrinsics=scaled(cameras[1].extrinsics, factor))
    )
    assert angle < 1e-2
    assert distance < 1e-3 * factor


def scaled(pose: NDArray[np.float64], factor: float) -> NDArray[np.float64]:
    pose = pose.copy()
    pose[:3, 3] *= factor
    return pose


def test_the_same_maps_give_the_same_bits() -> None:
    case = maps(true_cameras(3), noise=0.05, outliers=0.5)
    one, two = recover(*case), recover(*case)
    for a, b in zip(one.cameras, two.cameras, strict=True):
        np.testing.assert_array_equal(a.extrinsics, b.extrinsics)
    assert one.inlier_ratios == two.inlier_ratios


def degenerate(kind: str) -> NDArray[np.float64]:
    shape = (HEIGHT, WIDTH, 3)
    rng = np.random.default_rng(0)
    return {
        "one place": np.ones(shape),
        "zeros": np.zeros(shape),
        "a line": np.linspace(1, 5, HEIGHT * WIDTH).reshape(HEIGHT, WIDTH, 1) * [0.3, 0.2, 1.0],
        "nan": np.full(shape, np.nan),
        "infinite": np.full(shape, np.inf),
        "random": rng.uniform(-3, 3, shape),
    }[kind]


@pytest.mark.parametrize("kind", ["one place", "zeros", "a line", "nan", "infinite", "random"])
def test_degenerate_views_get_an_honest_stand_in(kind: str) -> None:
    cameras = true_cameras(3)
    points, opacities = maps(cameras)
    points[2] = degenerate(kind)
    result = recover(points, opacities)
    assert result.recovered == [True, True, False]
    assert any(note.startswith("view 3: no camera explains its points") for note in result.notes)
    np.testing.assert_array_equal(result.cameras[2].extrinsics, result.cameras[1].extrinsics)
    assert result.inlier_ratios[2] < 0.1


@pytest.mark.parametrize("kind", ["one place", "zeros", "nan"])
def test_degenerate_first_view_keeps_the_given_focal_length(kind: str) -> None:
    cameras = true_cameras(2)
    points, opacities = maps(cameras)
    points[0] = degenerate(kind)
    result = recover(points, opacities, normalised(cameras))
    assert result.focal is None
    assert result.cameras[0].fx == pytest.approx(120)
    assert "tell no focal length" in result.notes[0]
    assert_close(result, cameras, 1e-2, 1e-3)


def test_nothing_opaque() -> None:
    points, opacities = maps(true_cameras(2))
    result = recover(points, opacities * 0)
    assert result.recovered == [True, False]
    assert result.inlier_ratios == [0.0, 0.0]
