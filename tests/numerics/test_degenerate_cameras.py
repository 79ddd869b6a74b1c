"""Cameras of point maps that say little or lie: usable, or an honest stand-in; never a mirror."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.recover import Recovered, recover

HEIGHT, WIDTH, FOCAL = 48, 64, 60.0
Map = NDArray[np.float64]


def make_camera(turn: tuple[float, ...] = (0, 0, 0), centre: tuple[float, ...] = (0, 0, 0)):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    pose[:3, 3] = -pose[:3, :3] @ centre
    return Camera(pose, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, WIDTH, HEIGHT)


BESIDE = make_camera((0.05, -0.15, 0.04), (0.5, 0.1, -0.05))


def bumpy(camera: Camera) -> NDArray[np.float64]:
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    return 4 + np.sin(x / 9) + np.cos(y / 7)


def constant(camera: Camera) -> NDArray[np.float64]:
    return np.full((HEIGHT, WIDTH), 4.0)


def slanted(camera: Camera) -> NDArray[np.float64]:
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    return 4 / (1 + 0.5 * (x - camera.cx) / camera.fx + 0.2 * (y - camera.cy) / camera.fy)


def point_map(camera: Camera, surface) -> Map:
    """(H, W, 3) world points of a surface of these depths."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], -1)
    in_view = rays * surface(camera)[..., None]
    return (in_view - camera.extrinsics[:3, 3]) @ camera.extrinsics[:3, :3]


def found(first: Map, second: Map) -> Recovered:
    """Both views' cameras, sound whatever the maps say."""
    points = np.stack([first, second]).astype(np.float32)
    result = recover(points, np.full(points.shape[:3], 0.9, np.float32))
    for camera in result.cameras:
        rotation = camera.extrinsics[:3, :3]
        assert np.isfinite(camera.extrinsics).all()
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(rotation) == pytest.approx(1)
        assert 0 < camera.fx < np.inf
    assert result.recovered[1] or any(note.startswith("view 2") for note in result.notes)
    return result


def assert_found(result: Recovered, true: Camera, degrees: float, distance: float) -> None:
    assert result.recovered == [True, True]
    camera = result.cameras[1]
    step = camera.extrinsics[:3, :3] @ true.extrinsics[:3, :3].T
    assert np.degrees(Rotation.from_matrix(step).magnitude()) < degrees
    centres = [np.linalg.inv(c.extrinsics)[:3, 3] for c in (camera, true)]
    assert np.linalg.norm(centres[0] - centres[1]) < distance


def assert_stands_in(result: Recovered) -> None:
    assert result.recovered == [True, False]
    np.testing.assert_array_equal(result.cameras[1].extrinsics, result.cameras[0].extrinsics)


@pytest.mark.parametrize("surface", [bumpy, constant, slanted])
@pytest.mark.parametrize(
    "second",
    [
        BESIDE,
        make_camera((0.02, 0.3, -0.1)),
        make_camera((0, 0, 0), (1e-4, 0, 0)),
        make_camera(),
        make_camera((0, 0, np.pi)),
        make_camera((0, np.pi, 0), (0, 0, 8)),
    ],
    ids=["beside", "pure rotation", "tiny baseline", "the same", "upside down", "from behind"],
)
def test_planes_rotations_and_tiny_baselines(surface, second: Camera) -> None:
    """One view's points are enough for its pose, so neither parallax nor relief is needed."""
    result = found(point_map(make_camera(), surface), point_map(second, surface))
    assert result.focal == pytest.approx(FOCAL, rel=1e-4)
    assert_found(result, second, 1e-2, 1e-3)


@pytest.mark.parametrize("share", [0.3, 0.6, 0.7, 0.8])
@pytest.mark.parametrize("surface", [bumpy, constant])
def test_outliers_to_eighty_per_cent(surface, share: float) -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        points = point_map(BESIDE, surface)
        wild = rng.random((HEIGHT, WIDTH)) < share
        points[wild] = rng.uniform([-5, -4, 1], [5, 4, 8], (int(wild.sum()), 3))
        result = found(point_map(make_camera(), surface), points)
        assert_found(result, BESIDE, 0.5, 0.05)
        assert result.inlier_ratios[1] == pytest.approx(1 - share, abs=0.1)


@pytest.mark.parametrize("share", [0.8, 0.95, 1.0])
def test_outliers_beyond_reach_are_found_or_told(share: float) -> None:
    """A wrong pose needs a tenth of the points to agree by chance: they do not."""
    for seed in range(3):
        rng = np.random.default_rng(10 + seed)
        points = point_map(BESIDE, bumpy)
        wild = rng.random((HEIGHT, WIDTH)) < share
        points[wild] = rng.normal(0, 3, (int(wild.sum()), 3))
        result = found(point_map(make_camera(), bumpy), points)
        if result.recovered[1]:
            assert_found(result, BESIDE, 1.0, 0.1)
        else:
            assert_stands_in(result)
    assert share < 1 or not result.recovered[1]


def assert_doubted(result: Recovered) -> None:
    """Not found, or found with a warning and a ratio that no good map has."""
    if result.recovered[1]:
        assert result.inlier_ratios[1] < 0.1
        assert any("may be wrong" in note for note in result.notes)
    else:
        assert_stands_in(result)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_mirrored_map_is_no_camera(axis: int) -> None:
    """No rotation undoes a mirror; what fits a hollow mask a little is not passed off as sure."""
    points = point_map(BESIDE, bumpy)
    centre = points.mean(axis=(0, 1))[axis]
    points[..., axis] = 2 * centre - points[..., axis]
    assert_doubted(found(point_map(make_camera(), bumpy), points))


def test_a_map_behind_its_camera_is_no_camera() -> None:
    assert_doubted(found(point_map(make_camera(), bumpy), -point_map(make_camera(), bumpy)))


@pytest.mark.parametrize("count", [1, 300])
@pytest.mark.parametrize("distance", [1e5, 1e7, 1e30])
def test_points_far_away_do_not_make_the_others_flat(count: int, distance: float) -> None:
    points = point_map(BESIDE, bumpy)
    rng = np.random.default_rng(5)
    points.reshape(-1, 3)[rng.choice(HEIGHT * WIDTH, count, replace=False)] = distance
    assert_found(found(point_map(make_camera(), bumpy), points), BESIDE, 0.1, 0.01)


def extreme(kind: str) -> Map:
    points = point_map(BESIDE, bumpy)
    rng = np.random.default_rng(3)
    if kind == "half is not a number":
        points[rng.random((HEIGHT, WIDTH)) < 0.5] = np.nan
    elif kind == "some at the end of float32":
        points[rng.random((HEIGHT, WIDTH)) < 0.3] = 3e38
    elif kind == "some subnormal":
        points[rng.random((HEIGHT, WIDTH)) < 0.3] = 1e-42
    return points


@pytest.mark.parametrize(
    "kind", ["half is not a number", "some at the end of float32", "some subnormal"]
)
def test_values_at_the_ends_of_float32(kind: str) -> None:
    first = point_map(make_camera(), bumpy)
    assert_found(found(first, extreme(kind)), BESIDE, 0.5, 0.05)
    swapped = found(extreme(kind), first)  # and in the view that gives the focal length
    assert swapped.focal is None or 0.1 * WIDTH <= swapped.focal <= 20 * WIDTH


@pytest.mark.parametrize("unit", [1e-30, 1e-6, 1e6, 1e30])
def test_any_unit_of_length(unit: float) -> None:
    result = found(unit * point_map(make_camera(), bumpy), unit * point_map(BESIDE, bumpy))
    pose = BESIDE.extrinsics.copy()
    pose[:3, 3] *= unit
    assert_found(result, replace(BESIDE, extrinsics=pose), 1e-2, 1e-3 * unit)


@pytest.mark.parametrize("focal", [0.12, 0.5, 5.0, 18.0])
def test_lenses_from_fisheye_to_telescope(focal: float) -> None:
    lens = {"fx": focal * WIDTH, "fy": focal * WIDTH}
    first, second = replace(make_camera(), **lens), replace(BESIDE, **lens)
    second.extrinsics[:3, 3] *= min(1.0, 0.5 / focal)
    result = found(point_map(first, bumpy), point_map(second, bumpy))
    assert result.focal == pytest.approx(focal * WIDTH, rel=1e-3)
    assert_found(result, second, 0.1, 0.01)


def first_view_full_of(share: float, noise: float, seed: int) -> Recovered:
    """Both views' cameras; of the first view's points that share is wrong."""
    rng = np.random.default_rng(seed)
    points = np.stack([point_map(camera, bumpy) for camera in (make_camera(), BESIDE)])
    points += rng.normal(0, noise, points.shape)
    wild = rng.random((HEIGHT, WIDTH)) < share
    points[0][wild] = rng.uniform([-5, -4, 1], [5, 4, 8], (int(wild.sum()), 3))
    lens = np.float32([[FOCAL / WIDTH, 0, 0.5], [0, FOCAL / HEIGHT, 0.5], [0, 0, 1]])
    opacities = np.full(points.shape[:3], 0.9, np.float32)
    return recover(points.astype(np.float32), opacities, np.stack([lens, lens]), [True, True])


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.1])  # 0.1 is 1.5 pixels
@pytest.mark.parametrize("share", [0.3, 0.6, 0.7, 0.8])
def test_the_first_views_focal_length_among_outliers(share: float, noise: float) -> None:
    for seed in range(4, 8):
        result = first_view_full_of(share, noise, seed)
        assert [camera.fx for camera in result.cameras] == pytest.approx([FOCAL, FOCAL])
        assert result.focal == pytest.approx(FOCAL, rel=0.05 if noise else 1e-3)


@pytest.mark.parametrize("share", [0.9, 0.95, 1.0])
def test_no_focal_length_is_made_up_from_outliers(share: float) -> None:
    """Where not a tenth of the points agrees on one: the given one, and a note that says so."""
    for seed in range(4, 8):
        result = first_view_full_of(share, 0.02, seed)
        if result.focal is None:
            assert result.notes[0].endswith("tell no focal length; the given one is kept")
        else:
            assert result.focal == pytest.approx(FOCAL, rel=0.05)
    assert share < 1 or result.focal is None
