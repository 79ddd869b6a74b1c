"""Depths lose their grain and keep their edges."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.pointmap import pixel_centres
from styl3r_cli.pipeline import Scene
from styl3r_cli.smoothing import COLOUR, DEPTH, SPREAD, WINDOW, smoothed

SIDE = 48
CAMERA = Camera(np.eye(4), 40.0, 40.0, SIDE / 2, SIDE / 2, SIDE, SIDE)
GREY = np.full((3, SIDE, SIDE), 0.5, np.float32)


def turned() -> Camera:
    """A camera elsewhere, that looks elsewhere."""
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, -1], [0, 1, 0], [1, 0, 0]]
    pose[:3, 3] = [0.3, -2.0, 5.0]
    return replace(CAMERA, extrinsics=pose)


def scene_of(
    depth: NDArray[np.floating], image: NDArray[np.float32] = GREY, camera: Camera = CAMERA
) -> Scene:
    """One view that has these depths."""
    flat = (pixel_centres(SIDE, SIDE) - SIDE / 2) / 40.0
    seen = np.concatenate([flat, np.ones((SIDE, SIDE, 1))], axis=-1) * depth[..., None]
    turn, shift = camera.extrinsics[:3, :3], camera.extrinsics[:3, 3]
    return Scene(
        images=image[None],
        intrinsics=np.eye(3, dtype=np.float32)[None],
        means=np.einsum("hwi,ij->hwj", seen - shift, turn)[None].astype(np.float32),
        scales=np.full((1, SIDE, SIDE, 3), 0.1, np.float32),
        rotations=np.tile(np.float32([1, 0, 0, 0]), (1, SIDE, SIDE, 1)),
        opacities=np.ones((1, SIDE, SIDE), np.float32),
        content_tokens=np.zeros((1, 1, 1), np.float32),
    )


def depth_of(scene: Scene, camera: Camera = CAMERA) -> NDArray[np.float64]:
    return scene.means[0] @ camera.extrinsics[2, :3] + camera.extrinsics[2, 3]


def plane() -> NDArray[np.float64]:
    """A floor: inverse depth is linear over the picture."""
    y, x = np.mgrid[0:SIDE, 0:SIDE] / SIDE
    return 1 / (0.3 + 0.1 * x + 0.2 * y)


def grain(part: float) -> NDArray[np.float64]:
    return 1 + part * np.random.default_rng(0).normal(size=(SIDE, SIDE))


@pytest.mark.parametrize("camera", [CAMERA, turned()], ids=["at the origin", "elsewhere"])
def test_grain_goes_and_everything_stays_on_its_ray(camera: Camera) -> None:
    rough = scene_of(plane() * grain(0.02), camera=camera)
    made = smoothed(rough, [camera])
    off = [np.abs(depth_of(each, camera) / plane() - 1).mean() for each in (rough, made)]
    # Depths that differ by their grain count for less: it does not all go.
    assert off[1] < 0.45 * off[0]
    turn, shift = camera.extrinsics[:3, :3], camera.extrinsics[:3, 3]
    before, after = (each.means[0] @ turn.T + shift for each in (rough, made))
    np.testing.assert_allclose(
        after[..., :2] / after[..., 2:], before[..., :2] / before[..., 2:], atol=1e-5
    )
    grown = depth_of(made, camera) / depth_of(rough, camera)
    np.testing.assert_allclose(made.scales[0] / 0.1, np.dstack([grown] * 3), rtol=1e-5)
    assert made.opacities is not rough.opacities


def test_a_plane_stays() -> None:
    made = smoothed(scene_of(plane()), [CAMERA])
    inside = np.s_[WINDOW:-WINDOW, WINDOW:-WINDOW]
    np.testing.assert_allclose(depth_of(made)[inside], plane()[inside], rtol=2e-3)


@pytest.mark.parametrize("what", ["depth", "colour"])
def test_edges_stay(what: str) -> None:
    """A step of a third in depth; or one that is as small as grain, where the colour changes."""
    left = np.arange(SIDE) < SIDE // 2
    step, image = (1.3, GREY) if what == "depth" else (1.03, GREY * np.where(left, 0.2, 1.6))
    depth = np.where(left, 2.0, 2.0 * step) * np.ones((SIDE, 1))
    made = smoothed(scene_of(depth * grain(0.005), image.astype(np.float32)), [CAMERA])
    assert np.abs(depth_of(made) / depth - 1).max() < 0.01


def test_it_is_the_joint_bilateral_mean() -> None:
    """Against the sum as it is defined, in float64."""
    random = np.random.default_rng(1)
    depth = plane() * grain(0.03)
    image = (0.5 + 0.1 * random.normal(size=(3, SIDE, SIDE))).clip(0, 1).astype(np.float32)
    made = depth_of(smoothed(scene_of(depth, image), [CAMERA]))
    red, green, blue = image.astype(np.float64)
    guide = np.stack(
        [
            (0.299 * red + 0.587 * green + 0.114 * blue) / COLOUR,
            (red - blue) / COLOUR,
            -np.log(depth) / DEPTH,
        ]
    )
    for row, column in random.integers(WINDOW, SIDE - WINDOW, (40, 2)):
        total = weights = 0.0
        for down in range(-(WINDOW // 2), WINDOW // 2 + 1):
            for right in range(-(WINDOW // 2), WINDOW // 2 + 1):
                if np.hypot(down, right) > WINDOW // 2:
                    continue
                there = row + down, column + right
                apart = np.abs(guide[:, *there] - guide[:, row, column]).sum()
                weight = np.exp(-(apart**2) / 2 - (down**2 + right**2) / (2 * SPREAD**2))
                total, weights = total + weight / depth[there], weights + weight
        assert made[row, column] == pytest.approx(weights / total, rel=2e-3)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.0, -3.0])
def test_what_has_no_depth_stays_and_spoils_nothing(bad: float) -> None:
    depth = plane() * grain(0.01)
    whole = smoothed(scene_of(depth), [CAMERA])
    depth[20:24, 30] = bad
    broken = scene_of(depth)
    made = smoothed(broken, [CAMERA])
    np.testing.assert_array_equal(made.means[0, 20:24, 30], broken.means[0, 20:24, 30])
    rest = np.ones((SIDE, SIDE), bool)
    rest[20:24, 30] = False
    assert np.abs(depth_of(made)[rest] / depth_of(whole)[rest] - 1).max() < 0.01


def test_nothing_at_all_passes() -> None:
    scene = scene_of(np.full((SIDE, SIDE), np.nan))
    assert np.isnan(smoothed(scene, [CAMERA]).means).all()


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_the_unit_of_length_plays_no_part(unit: float) -> None:
    depth = plane() * grain(0.02)
    one, other = (smoothed(scene_of(depth * size), [CAMERA]) for size in (1.0, unit))
    np.testing.assert_allclose(depth_of(other) / unit, depth_of(one), rtol=1e-4)
