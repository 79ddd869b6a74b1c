"""Gaussians as discs on surfaces: against outer products of steps, and what may not change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from wavy_wall import wall as wall_of_wide_ones

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.pipeline import Scene
from styl3r_cli.surfels import BEHIND, LONGEST, REACH, THICKNESS, surfels

SIDE, FOCAL = 24, 30.0
Array = NDArray[np.float64]


def wall(count: int) -> tuple[Scene, Recovered]:
    """The wavy wall with Gaussians that are half a pixel wide, as the network's are."""
    scene, recovered = wall_of_wide_ones(count)
    return replace(scene, scales=scene.scales / 2), recovered


def covariances(scene: Scene) -> Array:
    """(N, H, W, 3, 3) of a scene's Gaussians."""
    turns = Rotation.from_quat(scene.rotations.reshape(-1, 4), scalar_first=True).as_matrix()
    long = turns * scene.scales.reshape(-1, 1, 3)
    return (long @ long.transpose(0, 2, 1)).reshape(*scene.scales.shape[:3], 3, 3)


def plane(slope: float, unit: float = 1.0, turn: Array | None = None) -> tuple[Scene, Recovered]:
    """One view of a plane that goes away to the right; `turn` is world-to-camera."""
    scene, recovered = wall(1)
    grid = (np.arange(SIDE) + 0.5 - SIDE / 2) / FOCAL
    x, y = np.meshgrid(grid, grid)
    depth = 2 * unit / (1 - slope * x)
    turn = np.eye(3) if turn is None else turn
    points = np.stack([x * depth, y * depth, depth], -1) @ turn
    pose = np.eye(4)
    pose[:3, :3] = turn
    camera = Camera(pose, FOCAL, FOCAL, SIDE / 2, SIDE / 2, SIDE, SIDE)
    cut = np.s_[:, :SIDE, :SIDE]
    scene = replace(
        scene,
        means=points[None].astype(np.float32),
        scales=scene.scales[cut] * np.float32(unit),
        rotations=scene.rotations[cut],
        opacities=scene.opacities[cut],
    )
    return scene, replace(recovered, cameras=[camera])


def test_a_disc_spans_what_its_pixel_sees_of_a_smooth_surface() -> None:
    """Within a view: the steps' outer products, along the normal the thickness."""
    scene, recovered = wall(2)
    made = covariances(surfels(scene, recovered))
    for view in range(2):
        points = scene.means[view].astype(np.float64)
        down, across = np.gradient(points, axis=(0, 1))
        normal = np.cross(across, down)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        camera = recovered.cameras[view]
        depth = points @ camera.extrinsics[2, :3] + camera.extrinsics[2, 3]
        thick = (THICKNESS * depth / camera.fx)[..., None] * normal
        want = sum(e[..., None] * e[..., None, :] for e in (REACH * across, REACH * down, thick))
        np.testing.assert_allclose(made[view], want, atol=1e-3 * np.abs(want).max())


@settings(max_examples=30, deadline=None)
@given(
    slope=st.floats(-0.9, 0.9),
    exponent=st.floats(-6, 6),
    turn=st.tuples(*[st.floats(-3, 3)] * 3),
)
def test_any_unit_and_any_world_give_the_same_discs(
    slope: float, exponent: float, turn: tuple[float, float, float]
) -> None:
    unit, rotation = 10.0**exponent, Rotation.from_rotvec(turn).as_matrix()
    plain = covariances(surfels(*plane(slope)))
    other = covariances(surfels(*plane(slope, unit, rotation)))
    back = rotation @ (other / unit**2) @ rotation.T
    np.testing.assert_allclose(back, plain, atol=2e-3 * np.abs(plain).max())


def test_a_disc_lies_in_its_plane_however_steep_and_no_longer_than_allowed() -> None:
    for slope in (0.0, 0.5, 2.0):
        scene, recovered = plane(slope)
        made = surfels(scene, recovered)
        normal = np.array([slope, 0, -1]) / np.hypot(slope, 1)  # x slope - z + 2 = 0
        through = np.sqrt(np.einsum("i,nhwij,j->nhw", normal, covariances(made), normal))
        pixel = scene.means[..., 2] / FOCAL
        if slope < 1:  # where neighbours are still seen to be of one surface
            np.testing.assert_allclose(through, THICKNESS * pixel, rtol=0.02)
        longest = made.scales.max(-1) / pixel
        assert longest.max() <= REACH * LONGEST * (1 + 1e-5)
        np.testing.assert_allclose(np.linalg.norm(made.rotations, axis=-1), 1, atol=1e-6)


def test_beside_an_edge_discs_span_their_own_surface_only() -> None:
    scene, recovered = plane(0.0)
    nearer = scene.means[0, :, : SIDE // 2] / 2
    scene.means[0, :, : SIDE // 2] = nearer
    made = surfels(scene, recovered)
    pixel = scene.means[..., 2:] / FOCAL
    np.testing.assert_allclose(made.scales[..., :2], np.repeat(REACH * pixel, 2, -1), rtol=1e-3)


def test_where_there_is_no_camera_or_no_point_before_it_nothing_changes() -> None:
    scene, recovered = wall(2)
    recovered.recovered[1] = False
    scene.means[0, 3, 4] = np.nan
    scene.means[0, 10, 10] = -scene.means[0, 10, 10]
    made = surfels(scene, recovered)
    for name in ("scales", "rotations"):
        before, after = getattr(scene, name), getattr(made, name)
        np.testing.assert_array_equal(after[1], before[1])
        for pixel in ((3, 4), (10, 10)):
            np.testing.assert_array_equal(after[0][pixel], before[0][pixel])
        assert np.isfinite(after).all()
    np.testing.assert_array_equal(made.means, scene.means)
    np.testing.assert_array_equal(made.opacities, scene.opacities)


def test_what_is_wide_stays_as_wide_in_the_picture_and_goes_behind() -> None:
    scene, recovered = wall(2)
    scene.scales[1, :4] = 0.3
    made, camera = surfels(scene, recovered), recovered.cameras[1]
    turn, shift = camera.extrinsics[:3, :3], camera.extrinsics[:3, 3]
    before, after = (each.means[1] @ turn.T + shift for each in (scene, made))
    np.testing.assert_allclose(after[:4], before[:4] * (1 + BEHIND), rtol=1e-5)
    np.testing.assert_allclose(after[4:], before[4:], rtol=1e-6)
    np.testing.assert_allclose(made.scales[1, :4], 0.3 * (1 + BEHIND), rtol=1e-6)
    np.testing.assert_array_equal(made.rotations[1, :4], scene.rotations[1, :4])


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1)])
def test_a_picture_of_one_row_has_discs_that_face_the_camera(shape: tuple[int, int]) -> None:
    scene, recovered = plane(0.0)
    cut = np.s_[:, : shape[0], : shape[1]]
    arrays = {n: getattr(scene, n)[cut] for n in ("means", "scales", "rotations", "opacities")}
    made = surfels(replace(scene, **arrays), recovered)
    pixel = made.means[..., 2:] / FOCAL
    np.testing.assert_allclose(made.scales[..., :2], np.repeat(REACH * pixel, 2, -1), rtol=1e-4)
