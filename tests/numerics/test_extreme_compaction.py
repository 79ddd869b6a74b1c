"""Compaction of scenes at the ends of what they can be: a sound scene that looks the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.compaction import keep_count, witnesses
from styl3r_cli.gaussians import Gaussians

SIDE = 24


def make_scene(count: int = 400) -> Gaussians:
    rng = np.random.default_rng(0)
    return Gaussians(
        rng.uniform([-1, -1, 2], [1, 1, 3], (count, 3)),
        0.05 * np.exp(rng.normal(0, 0.5, (count, 3))),
        Rotation.random(count, random_state=0).as_quat(scalar_first=True),
        rng.uniform(0.1, 1, count),
        rng.uniform(0, 1, (count, 3)),
    )


def make_cameras(unit: float = 1.0) -> list[Camera]:
    cameras = []
    for x in (0.0, 0.2):
        pose = np.eye(4)
        pose[0, 3] = -x * unit
        cameras.append(Camera(pose, 24.0, 24.0, SIDE / 2, SIDE / 2, SIDE, SIDE))
    return cameras


def changed(kind: str) -> Gaussians:
    scene = make_scene()
    count = len(scene)
    if kind == "one place":
        return replace(scene, means=np.tile(np.float32([0, 0, 2.5]), (count, 1)))
    if kind == "one Gaussian, many times":
        return scene.select(np.zeros(count, int))
    if kind == "points":
        return replace(scene, scales=np.zeros((count, 3)))
    if kind == "needles":
        return replace(scene, scales=np.tile(np.float32([1e-6, 1e-6, 1e2]), (count, 1)))
    if kind == "giants":
        return replace(scene, scales=np.full((count, 3), 1e6))
    if kind == "opaque":
        return replace(scene, opacities=np.ones(count))
    if kind == "one pair":
        return scene.select(np.arange(2))
    if kind == "some poisoned":
        means, rotations = scene.means.copy(), scene.rotations.copy()
        means[::7] = np.nan
        means[3::7] = 3e38
        rotations[1::7] = 0
        return replace(scene, means=means, rotations=rotations)
    return scene


KINDS = (
    "ordinary", "one place", "one Gaussian, many times", "points", "needles", "giants", "opaque",
    "one pair", "some poisoned",
)  # fmt: skip


def assert_sound(made, most: int) -> None:
    scene = made.gaussians
    assert 0 < len(scene) <= most
    for name in ("means", "scales", "rotations", "opacities", "colours"):
        assert np.isfinite(getattr(scene, name)).all(), name
    np.testing.assert_allclose(np.linalg.norm(scene.rotations, axis=1), 1, rtol=1e-3)
    assert scene.scales.min() >= 0
    assert 0 <= scene.opacities.min() <= scene.opacities.max() <= 1
    assert np.isfinite(made.decibels).all()


@pytest.mark.parametrize("kind", KINDS)
def test_any_scene_stays_sound(kind: str) -> None:
    scene = changed(kind)
    most = max(1, len(scene) // 4)
    made = keep_count(scene, witnesses(make_cameras(), scene), most, threads=1)
    assert_sound(made, most)
    if kind == "one Gaussian, many times":
        assert made.worst > 30


@pytest.mark.parametrize("unit", [1e-30, 1e-15, 1e-6, 1e6, 1e15, 1e20, 1e30, 1e36])
def test_any_unit_of_length(unit: float) -> None:
    scene = make_scene()
    plain = keep_count(scene, make_cameras(), 100, threads=1)
    factor = np.float32(unit)
    scaled = replace(scene, means=scene.means * factor, scales=scene.scales * factor)
    made = keep_count(scaled, make_cameras(unit), 100, threads=1)
    assert_sound(made, 100)
    assert made.worst == pytest.approx(plain.worst, abs=0.1)


@pytest.mark.parametrize("scale", [1e10, 1e20, 5e34, 3e38])
def test_any_size_of_gaussians(scale: float) -> None:
    """One is left, and it covers what all of them covered."""
    scene = replace(make_scene(), scales=np.full((400, 3), np.float32(scale)))
    made = keep_count(scene, make_cameras(), 1, threads=1)
    assert_sound(made, 1)
    assert made.worst > 40


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("brightness", [1e5, 1e30, 3e38])
def test_any_brightness(brightness: float) -> None:
    """Half of the colours are far brighter, half far darker than any display can show."""
    scene = make_scene()
    signs = np.where(np.arange(400) % 2, 1, -1)[:, None]
    made = keep_count(
        scene.with_colours((signs * brightness * scene.colours).astype(np.float32)),
        make_cameras(),
        100,
        threads=1,
    )
    assert len(made.gaussians) == 100
    assert all(np.isfinite(made.decibels))
    for name in ("means", "scales", "rotations", "opacities", "colours"):
        assert np.isfinite(getattr(made.gaussians, name)).all()
