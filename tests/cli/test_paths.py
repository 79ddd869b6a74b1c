"""Camera paths: where they go, and that they loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.paths import PATHS, WOBBLE_SHIFT, default_camera, make_path
from styl3r_cli.errors import UsageError
from styl3r_cli.gaussians import Gaussians


def make_scene(near: float = 1.5, far: float = 6.0, unit: float = 1.0, seed: int = 0) -> Gaussians:
    """Points that fill the frame of a camera at the origin, at depths near to far."""
    rng = np.random.default_rng(seed)
    count = 2000
    depths = rng.uniform(near, far, count)
    slopes = rng.uniform(-0.5, 0.5, (count, 2))
    means = np.concatenate([slopes * depths[:, None], depths[:, None]], axis=1) * unit
    turns = np.tile([1.0, 0, 0, 0], (count, 1))
    ones = np.ones((count, 3))
    return Gaussians(means, 0.01 * unit * ones, turns, np.ones(count), ones)


def make_camera(turn=(0, 0, 0), centre=(0.0, 0, 0), **changes) -> Camera:
    extrinsics = np.eye(4)
    extrinsics[:3, :3] = Rotation.from_euler("xyz", turn, degrees=True).as_matrix().T
    extrinsics[:3, 3] = -extrinsics[:3, :3] @ np.array(centre)
    return replace(Camera(extrinsics, 200.0, 200, 100, 100, 200, 200), **changes)


def centres(path: list[Camera]) -> np.ndarray:
    return np.array([np.linalg.inv(camera.extrinsics)[:3, 3] for camera in path])


def project(camera: Camera, points: np.ndarray) -> np.ndarray:
    in_view = points @ camera.extrinsics[:3, :3].T + camera.extrinsics[:3, 3]
    return in_view[:, :2] / in_view[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]


VIEWS = [
    make_camera(),
    make_camera((5, 10, 0), (0.3, 0, 0.1)),
    make_camera((0, 25, 5), (0.5, 0.1, 0)),
]


@pytest.mark.parametrize("name", PATHS)
def test_a_path_loops_without_a_jump(name):
    path = make_path(name, VIEWS, make_scene(), 60)
    assert len(path) == 60
    places = centres(path)
    steps = np.linalg.norm(np.roll(places, -1, axis=0) - places, axis=1)
    turns = [
        Rotation.from_matrix((b.extrinsics @ np.linalg.inv(a.extrinsics))[:3, :3]).magnitude()
        for a, b in zip(path, path[1:] + path[:1], strict=True)
    ]
    assert 0 < steps.max() < 0.06
    # Seen from the last frame, the first is no farther than the frames around it are apart.
    assert steps[-1] <= 1.5 * max(steps[-2], steps[0])
    assert turns[-1] <= 1.5 * max(turns[-2], turns[0])
    assert np.abs(np.diff(steps)).max() < 0.02


@pytest.mark.parametrize("name", PATHS)
@pytest.mark.parametrize("frames", [1, 2, 7])
def test_extrinsics_are_rigid_and_frames_keep_their_size(name, frames):
    for camera in make_path(name, VIEWS, make_scene(), frames):
        turn = camera.extrinsics[:3, :3]
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(turn) == pytest.approx(1)
        np.testing.assert_array_equal(camera.extrinsics[3], [0, 0, 0, 1])
        assert (camera.width, camera.height) == (200, 200)


def test_a_wobble_circles_the_middle_view_and_faces_the_median_depth():
    scene = make_scene()
    path = make_path("wobble", VIEWS, scene, 40)
    middle = VIEWS[1]
    np.testing.assert_allclose(centres(path).mean(axis=0), [0.3, 0, 0.1], atol=1e-9)
    in_view = scene.means @ middle.extrinsics[:3, :3].T + middle.extrinsics[:3, 3]
    pixels = project(middle, scene.means)
    seen = ((pixels >= 0) & (pixels <= 200)).all(axis=1) & (in_view[:, 2] > 0)
    target = np.linalg.inv(middle.extrinsics) @ [0, 0, np.median(in_view[seen, 2]), 1]
    for camera in path:
        np.testing.assert_allclose(project(camera, target[None, :3]), [[100, 100]], atol=1e-3)


@pytest.mark.parametrize("depths", [(1.5, 6.0), (1.9, 2.1), (0.2, 50.0)])
def test_a_wobbles_parallax_is_visible_but_small(depths):
    scene = make_scene(*depths)
    path = make_path("wobble", [make_camera()], scene, 16)
    kept = scene.means[:, 2] > np.percentile(scene.means[:, 2], 6)
    kept &= np.abs(scene.means[:, :2] / scene.means[:, 2:]).max(axis=1) < 0.2
    start = project(make_camera(), scene.means[kept])
    shifts = [project(camera, scene.means[kept]) - start for camera in path]
    largest = np.abs(shifts).max() / 200
    assert largest < 1.4 * WOBBLE_SHIFT
    assert largest > (0.4 * WOBBLE_SHIFT if depths != (1.9, 2.1) else 0.1 * WOBBLE_SHIFT)


def test_the_unit_of_length_does_not_matter():
    one = make_path("wobble", [make_camera()], make_scene(), 8)
    many = make_path("wobble", [make_camera()], make_scene(unit=1000), 8)
    np.testing.assert_allclose(centres(many), 1000 * centres(one), rtol=1e-4, atol=1e-3)


def test_a_wider_wobble_on_request():
    narrow, wide = (
        make_path("wobble", [make_camera()], make_scene(), 8, amplitude=a) for a in (0.5, 2.0)
    )
    np.testing.assert_allclose(centres(wide), 4 * centres(narrow), atol=1e-12)


def test_a_scene_without_cameras_wobbles_around_the_origin():
    path = make_path("wobble", [], make_scene(), 12)
    np.testing.assert_allclose(centres(path).mean(axis=0), 0, atol=1e-9)
    camera = default_camera(make_scene())
    np.testing.assert_array_equal(camera.extrinsics, np.eye(4))
    pixels = project(camera, make_scene().means)
    inside = ((pixels >= 0) & (pixels <= [camera.width, camera.height])).all(axis=1)
    assert inside.mean() == pytest.approx(0.95, abs=0.01)


def test_the_default_camera_steps_back_from_a_scene_around_the_origin():
    rng = np.random.default_rng(1)
    scene = make_scene()
    scene = replace(scene, means=rng.normal(0, 1, (2000, 3)) - np.array([5, 0, 2]))
    camera = default_camera(scene, 300, 200)
    pixels = project(camera, scene.means)
    assert ((pixels >= 0) & (pixels <= [300, 200])).all(axis=1).mean() > 0.85


def test_scenes_without_anything_to_look_at():
    empty = make_scene().select(np.zeros(0, int))
    assert len(make_path("wobble", [], empty, 5)) == 5
    behind = replace(make_scene(), means=make_scene().means * np.float32([1, 1, -1]))
    for camera in make_path("wobble", [make_camera()], behind, 5):
        assert np.isfinite(camera.extrinsics).all()


def test_interpolate_passes_through_every_view():
    views = [make_camera((0, 10 * k, 3 * k), (0.2 * k, 0.05 * k * k, 0)) for k in range(5)]
    # Eased, the path is a quarter of its way after a third of half a loop.
    path = make_path("interpolate", views, make_scene(), 12)
    for frame, view in [(0, 0), (2, 1), (3, 2), (4, 3), (6, 4), (8, 3), (9, 2), (10, 1)]:
        np.testing.assert_allclose(path[frame].extrinsics, views[view].extrinsics, atol=1e-9)


def test_between_two_views_it_is_slerp_and_a_line():
    a, b = make_camera((10, 0, 0)), make_camera((0, 60, 20), (1.0, 2, 3))
    path = make_path("interpolate", [a, b], make_scene(), 20)
    rotations = Rotation.from_matrix([np.linalg.inv(c.extrinsics)[:3, :3] for c in (a, b)])
    slerp = Slerp([0, 1], rotations)
    line = centres(path)
    way = line[:, 0]
    np.testing.assert_allclose(line, way[:, None] * np.array([1, 2, 3]), atol=1e-9)
    assert (np.diff(way[:11]) > 0).all()
    for camera, t in zip(path, way, strict=True):
        expected = slerp(np.clip(t, 0, 1)).as_matrix().T
        np.testing.assert_allclose(camera.extrinsics[:3, :3], expected, atol=1e-6)


def test_lenses_are_interpolated_into_the_first_views_frame():
    wide = make_camera(fx=100.0, fy=100.0)
    double = make_camera(fx=800.0, fy=800.0, cx=200.0, cy=200.0, width=400, height=400)
    path = make_path("interpolate", [wide, double], make_scene(), 10)
    assert path[5].fx == pytest.approx(400)
    assert path[5].cx == pytest.approx(100)
    assert {(camera.width, camera.height) for camera in path} == {(200, 200)}


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 8), st.integers(1, 30))
def test_any_views_give_finite_rigid_cameras(seed, views, frames):
    rng = np.random.default_rng(seed)
    cameras = [make_camera(rng.uniform(-180, 180, 3), rng.normal(size=3)) for _ in range(views)]
    for camera in make_path("interpolate", cameras, make_scene(), frames):
        turn = camera.extrinsics[:3, :3]
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
        assert np.isfinite(camera.extrinsics).all()


def test_impossible_wishes_are_refused():
    scene = make_scene()
    with pytest.raises(UsageError, match="wobble"):
        make_path("moonwalk", VIEWS, scene, 10)
    with pytest.raises(UsageError, match="0 frames"):
        make_path("wobble", VIEWS, scene, 0)
    with pytest.raises(UsageError, match="amplitude"):
        make_path("wobble", VIEWS, scene, 5, amplitude=0)
    for views in ([], VIEWS[:1]):
        with pytest.raises(UsageError, match="2 or more"):
            make_path("interpolate", views, scene, 5)
