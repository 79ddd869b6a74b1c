"""Sizes and steps that bring points together, against the ones that took them apart."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.similarity import moved_camera, size_and_step, size_of

DIRECTION = np.array([0.6, 0.0, 0.8])


@pytest.mark.parametrize("outliers", [0, 30])
@given(st.floats(0.1, 10), st.floats(0.01, 5))
def test_size_and_step_are_found(outliers: int, size: float, step: float) -> None:
    random = np.random.default_rng(0)
    here = random.uniform([-1, -1, 1], [1, 1, 4], (100, 3))
    there = (here + step * DIRECTION) / size
    there[:outliers] *= random.uniform(0.3, 2, (outliers, 1))
    found = size_and_step(here, there, DIRECTION)
    assert found == pytest.approx((size, step), rel=0.1 if outliers else 1e-6)


def test_nothing_is_found_where_nothing_fits() -> None:
    here = np.random.default_rng(0).uniform([-1, -1, 1], [1, 1, 4], (50, 3))
    assert size_and_step(here, here - DIRECTION, DIRECTION) is None  # a step backwards
    assert size_and_step(here, np.full_like(here, np.nan), DIRECTION) is None
    assert size_and_step(here[:1], here[:1], DIRECTION) is None


@given(st.floats(0.01, 100), st.integers(0, 1000))
def test_a_moved_camera_sees_the_moved_world_as_before(size: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    pose, change = np.eye(4), np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(random.normal(size=3))[0]
    pose[:3, 3] = random.normal(size=3)
    change[:3, :3] = size * cv2.Rodrigues(random.normal(size=3))[0]
    change[:3, 3] = random.normal(size=3)
    camera = Camera(pose, 100.0, 100.0, 50.0, 50.0, 100, 100)
    moved = moved_camera(camera, change)
    assert size_of(change) == pytest.approx(size)
    turn = moved.extrinsics[:3, :3]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
    points = np.concatenate([random.normal(size=(20, 3)), np.ones((20, 1))], axis=1)
    before, after = points @ pose.T, points @ change.T @ moved.extrinsics.T
    np.testing.assert_allclose(after[:, :3], size * before[:, :3], rtol=1e-6, atol=1e-6 * size)
