"""Camera paths: where they go, and that they loop."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.course import Course, frames_along
from styl3r_cli.cameras.extent import Extent, quantiles
from styl3r_cli.cameras.overview import default_camera
from styl3r_cli.cameras.paths import PATHS, make_path
from styl3r_cli.cameras.swings import WOBBLE_SHIFT
from styl3r_cli.errors import UsageError
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.splatting import render


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
    assert 0 < steps.max() < 0.15
    # Seen from the last frame, the first is no farther than the frames around it are apart.
    assert steps[-1] <= 1.5 * max(steps[-2], steps[0])
    assert turns[-1] <= 1.5 * max(turns[-2], turns[0])
    assert np.abs(np.diff(steps)).max() < 0.2 * steps.max()


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
    lens = {"fx": 200.0, "fy": 200.0}  # the path's is a little longer, to hide the edges
    shifts = [project(replace(camera, **lens), scene.means[kept]) - start for camera in path]
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


@pytest.mark.parametrize(
    "middle", [(8, 0, 5), (0, -30, 1), (450, 5400, 300), (0, 0, 100), (900, 900, 900)]
)
@pytest.mark.parametrize("path", ["wobble", "orbit", "spiral", "dolly"])
def test_a_scene_elsewhere_is_in_the_frame_and_fills_it(middle, path):
    means = np.random.default_rng(1).normal(0, 1, (2000, 3)) + middle
    scene = replace(make_scene(), means=means)
    for camera in [default_camera(scene, 300, 200), *make_path(path, [], scene, 4)]:
        pixels = project(camera, means)
        inside = ((pixels >= 0) & (pixels <= [camera.width, camera.height])).all(axis=1)
        ahead = means @ camera.extrinsics[2, :3] + camera.extrinsics[2, 3] > 0
        assert (inside & ahead).mean() > 0.5
        assert np.ptp(pixels[inside & ahead], axis=0).max() > 0.5 * camera.width


def test_a_scene_seen_through_a_long_lens_is_still_seen_from_the_origin():
    pixels = np.random.default_rng(1).uniform(-1, 1, (2000, 2))
    depths = np.random.default_rng(2).uniform(5, 9, (2000, 1))
    rays = np.hstack([np.tan(np.radians(5)) * pixels, np.ones((2000, 1))])
    scene = replace(make_scene(), means=rays * depths)
    np.testing.assert_array_equal(default_camera(scene).extrinsics, np.eye(4))


def test_one_gaussian_ahead_is_seen_from_the_origin():
    one = make_scene().select(np.array([0]))
    one = replace(one, means=np.array([[0.1, 0.2, 7.0]]))
    np.testing.assert_array_equal(default_camera(one).extrinsics, np.eye(4))


def test_scenes_without_anything_to_look_at():
    empty = make_scene().select(np.zeros(0, int))
    assert len(make_path("wobble", [], empty, 5)) == 5
    behind = replace(make_scene(), means=make_scene().means * np.float32([1, 1, -1]))
    for camera in make_path("wobble", [make_camera()], behind, 5):
        assert np.isfinite(camera.extrinsics).all()


def test_interpolate_passes_through_every_view():
    views = [make_camera((0, 10 * k, 3 * k), (0.2 * k, 0.05 * k * k, 0)) for k in range(5)]
    path = make_path("interpolate", views, make_scene(), 2001, loop=False)
    np.testing.assert_allclose(path[0].extrinsics, views[0].extrinsics, atol=1e-9)
    np.testing.assert_allclose(path[-1].extrinsics, views[-1].extrinsics, atol=1e-9)
    nearest = [min(np.abs(c.extrinsics - v.extrinsics).max() for c in path) for v in views]
    assert max(nearest) < 1e-3
    order = [int(np.argmin(np.linalg.norm(centres(path) - c, axis=1))) for c in centres(views)]
    assert order == sorted(order)


def test_unevenly_taken_views_are_passed_at_an_even_speed_without_detours():
    """The quick turn between near views, and the crawl between far ones, of a uniform spline."""
    places = [0.0, 0.02, 0.6, 0.65, 2.0]
    views = [make_camera(centre=(x, 0, 0)) for x in places]
    path = make_path("interpolate", views, make_scene(), 300, loop=False, eased=False)
    steps = np.diff(centres(path)[:, 0])
    assert (steps > 0).all()
    np.testing.assert_allclose(steps, 2.0 / 299, rtol=0.02)


def test_repeated_views_are_one_stop():
    views = [VIEWS[0], VIEWS[1], VIEWS[1], VIEWS[2]]
    twice, once = (make_path("interpolate", v, make_scene(), 50) for v in (views, VIEWS))
    for a, b in zip(twice, once, strict=True):
        np.testing.assert_array_equal(a.extrinsics, b.extrinsics)
    still = make_path("interpolate", [VIEWS[1]] * 3, make_scene(), 4)
    np.testing.assert_allclose(centres(still), centres([VIEWS[1]] * 4), atol=1e-12)


def test_the_curve_and_its_speed_have_no_kinks():
    """Sampled four times as finely, steps differ a quarter as much: a kink would stay."""
    rng = np.random.default_rng(4)
    views = [make_camera(rng.uniform(-20, 20, 3), rng.normal(size=3)) for _ in range(6)]

    def roughness(frames):
        path = make_path("interpolate", views, make_scene(), frames, loop=False, eased=False)
        turns = [
            Rotation.from_matrix((b.extrinsics @ np.linalg.inv(a.extrinsics))[:3, :3]).as_rotvec()
            for a, b in pairwise(path)
        ]
        changes = []
        for steps in (np.diff(centres(path), axis=0), np.array(turns)):
            size = np.linalg.norm(steps, axis=1).mean()
            changes.append(np.linalg.norm(np.diff(steps, axis=0), axis=1).max() / size)
        return max(changes)

    assert roughness(4000) < 0.4 * roughness(1000)


def angles_around(path, target):
    """(F,) azimuths of the cameras around a vertical axis through the target, degrees."""
    arms = centres(path) - target
    return np.degrees(np.unwrap(np.arctan2(arms[:, 0], -arms[:, 2])))


def test_an_orbit_is_level_and_keeps_its_distance_and_its_middle():
    scene = make_scene()
    views = [make_camera((15, 0, 0)), make_camera((15, 20, 0), (-1.2, 0.0, 0.2))]
    path = make_path("orbit", views, scene, 36, arc=np.radians(50))
    middle = views[0]
    depth = Extent.of(scene).depths(middle)[1]
    target = np.linalg.inv(middle.extrinsics) @ [0, 0, depth, 1]
    arms = centres(path) - target[:3]
    np.testing.assert_allclose(np.linalg.norm(arms, axis=1), depth, rtol=1e-6)
    assert (
        np.ptp(centres(path)[:, 1]) < 0.03 * depth
    )  # tilted down, it goes round level all the same
    assert np.ptp(angles_around(path, target[:3])) == pytest.approx(50, abs=2)
    for camera in path:
        np.testing.assert_allclose(project(camera, target[None, :3]), [[100, 100]], atol=1e-6)


def test_a_full_circle_has_the_whole_scene_in_every_frame():
    rng = np.random.default_rng(2)
    ball = rng.normal(size=(2000, 3)) * [1, 0.5, 2] + [3, 1, -4]
    scene = replace(make_scene(), means=ball)
    path = make_path("orbit", [], scene, 24)  # no views: a foreign scene, seen from all sides
    assert np.ptp(angles_around(path, ball.mean(axis=0))) == pytest.approx(345, abs=3)
    for camera in path:
        pixels = project(camera, ball)
        assert ((pixels >= 0) & (pixels <= 512)).all(axis=1).mean() > 0.97


def test_views_from_all_sides_make_a_full_circle():
    views = [make_camera((0, turn, 0), 4 * look(turn)) for turn in range(0, 360, 45)]
    rng = np.random.default_rng(3)
    scene = replace(make_scene(), means=rng.normal(0, 0.4, (2000, 3)))
    assert np.ptp(angles_around(make_path("orbit", views, scene, 24), 0)) > 340
    assert np.ptp(angles_around(make_path("orbit", views[:2], scene, 24), 0)) < 60


def look(turn):
    """Minus where a camera that is turned about the vertical looks."""
    return -Rotation.from_euler("y", turn, degrees=True).as_matrix()[:, 2]


@pytest.mark.parametrize("name", ["orbit", "spiral", "dolly", "wobble"])
def test_a_movement_keeps_the_scene_in_frame_and_does_not_fly_into_it(name):
    """A wall behind, and a post in front that a larger movement would run into."""
    rng = np.random.default_rng(0)
    wall = np.column_stack([rng.uniform(-2, 2, (8000, 2)), np.full(8000, 4.0)])
    post = np.column_stack([rng.normal(0, 0.05, 800), rng.uniform(-1, 1, 800), np.full(800, 1.2)])
    means = np.concatenate([wall, post])
    ones = np.ones((len(means), 3))
    turns = np.tile([1.0, 0, 0, 0], (len(means), 1))
    scene = Gaussians(means, 0.02 * ones, turns, np.ones(len(means)), ones)
    views = [make_camera(centre=(x, 0, 0)) for x in (-1.5, 0.0, 1.5)]
    for camera in make_path(name, views, scene, 24):
        gaps = np.linalg.norm(post - np.linalg.inv(camera.extrinsics)[:3, 3], axis=1)
        assert gaps.min() > 0.4
        frame = render(
            scene,
            replace(camera, fx=camera.fx / 4, fy=camera.fy / 4, cx=25, cy=25, width=50, height=50),
            threads=1,
        )
        assert (frame.alpha > 0.3).mean() > 0.9


def test_floaters_do_not_count():
    scene = make_scene()
    stray = scene.select(np.arange(20))
    stray = replace(stray, means=np.full((20, 3), 1e4), opacities=np.full(20, 0.3))
    ghost = replace(stray, means=np.zeros((20, 3)), opacities=np.full(20, 0.05))
    both = [
        np.concatenate([getattr(part, name) for part in (scene, stray, ghost)])
        for name in ("means", "scales", "rotations", "opacities", "colours")
    ]
    clean, dirty = Extent.of(scene), Extent.of(Gaussians(*both))
    np.testing.assert_allclose(dirty.bounds(), clean.bounds(), atol=0.1)
    assert dirty.clearance(make_camera()) == pytest.approx(clean.clearance(make_camera()), abs=0.05)
    assert dirty.depths(make_camera()) == pytest.approx(clean.depths(make_camera()), rel=0.02)


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=30), st.integers(1, 4))
def test_a_weight_counts_like_repetitions(values, times):
    values = np.array(values)
    shares = (0.0, 0.3, 0.5, 1.0)
    weighted = quantiles(values, np.full(len(values), float(times)), shares)
    assert weighted == pytest.approx(quantiles(values, np.ones(len(values)), shares), abs=1e-9)
    assert weighted[2] == pytest.approx(np.median(values), rel=1e-9, abs=1e-9)
    assert weighted[0] == values.min()
    assert weighted[3] == values.max()


def test_a_heavy_value_is_the_median():
    assert quantiles(np.array([3.0, 1.0, 2.0]), np.array([10.0, 1, 1]), (0.6,)) == [3.0]


def test_once_through_or_there_and_back_eased_or_even():
    course = Course(lambda place: make_camera(centre=(place, 0, 0)), closed=False, eased=True)

    def places(**how):
        return centres(frames_along(course, 8, **how))[:, 0]

    np.testing.assert_allclose(places(loop=False, eased=False), np.arange(8) / 7)
    np.testing.assert_allclose(places(eased=False), [0, 0.25, 0.5, 0.75, 1, 0.75, 0.5, 0.25])
    np.testing.assert_allclose(places(), 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(8) / 8))
    np.testing.assert_allclose(places(loop=False), 0.5 - 0.5 * np.cos(np.pi * np.arange(8) / 7))


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
