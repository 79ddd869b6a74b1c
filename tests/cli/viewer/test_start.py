"""The viewer's first picture is the first photo's, and its up is the scene's."""

from __future__ import annotations

import math

import numpy as np
import pytest

from styl3r_cli.cameras import poses
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.viewer.start import first_view, view_of


@pytest.fixture
def wall() -> Gaussians:
    rng = np.random.default_rng(5)
    means = np.column_stack([rng.uniform(-1, 1, (400, 2)), rng.uniform(2.9, 3.1, 400)])
    return Gaussians(
        means,
        np.full((400, 3), 0.02),
        np.tile([1.0, 0, 0, 0], (400, 1)),
        np.ones(400),
        np.full((400, 3), 0.5),
    )


def tilted(pitch: float, roll: float = 0.0) -> Camera:
    """A camera at (0.3, -0.2, 0.1) that looks down by `pitch` and leans by `roll`, degrees."""
    c, s = math.cos(math.radians(pitch)), math.sin(math.radians(pitch))
    a, b = math.cos(math.radians(roll)), math.sin(math.radians(roll))
    lean = np.array([[a, b, 0], [-b, a, 0], [0, 0, 1]])
    extrinsics = np.eye(4)
    extrinsics[:3, :3] = lean @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    extrinsics[:3, 3] = -extrinsics[:3, :3] @ [0.3, -0.2, 0.1]
    return Camera(extrinsics, 300.0, 310.0, 128.0, 96.0, 256, 192)


def axes_of(position: np.ndarray, look_at: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Right, down, forward of a camera that is given as graphics libraries do (gluLookAt)."""
    forward = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.cross(forward, up) / np.linalg.norm(np.cross(forward, up))
    return np.stack([right, np.cross(forward, right), forward])


@pytest.mark.parametrize("pitch", [-30, 0, 12, 40, 80])
@pytest.mark.parametrize("roll", [-20, 0, 3, 100, 180])
def test_the_picture_stays_as_it_is(wall: Gaussians, pitch: float, roll: float) -> None:
    camera = tilted(pitch, roll)
    view = view_of(camera, wall, np.array([0.0, -1.0, 0.0]))
    np.testing.assert_allclose(
        axes_of(view.position, view.look_at, view.up), camera.extrinsics[:3, :3], atol=1e-9
    )
    np.testing.assert_allclose(view.position, [0.3, -0.2, 0.1], atol=1e-12)
    assert math.tan(view.fov / 2) == pytest.approx(96 / 310)


def test_up_is_the_scenes_where_the_camera_is_level(wall: Gaussians) -> None:
    view = view_of(tilted(25), wall, np.array([0.0, -1.0, 0.0]))
    np.testing.assert_allclose(view.up, [0, -1, 0], atol=1e-12)


def test_it_turns_around_what_is_in_the_middle(wall: Gaussians) -> None:
    level = Camera(np.eye(4), 300.0, 300.0, 128.0, 96.0, 256, 192)
    view = first_view(wall, [level, tilted(10)])
    np.testing.assert_array_equal(view.position, poses.centre(level.extrinsics))
    np.testing.assert_allclose(view.look_at, [0, 0, 3], atol=0.05)
    assert view.depth == pytest.approx(3, abs=0.05)


def test_without_cameras_it_takes_in_the_scene(wall: Gaussians) -> None:
    view = first_view(wall, [])
    np.testing.assert_allclose(view.up, [0, -1, 0], atol=1e-12)
    assert view.look_at[2] == pytest.approx(3, abs=0.05)
    assert math.tan(view.fov / 2) * 3 == pytest.approx(1, abs=0.1)  # the wall's half height
