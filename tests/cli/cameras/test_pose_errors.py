"""Errors of cameras in degrees, against scipy's rotations and known directions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from styl3r_cli.cameras.pose_errors import direction_error, rotation_error


@given(
    st.lists(st.floats(0, 3), min_size=3, max_size=3),
    st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3),
)
@settings(max_examples=30, deadline=None)
def test_rotation_error_is_the_angle_between(a: list[float], b: list[float]) -> None:
    one, two = np.eye(4), np.eye(4)
    one[:3, :3], two[:3, :3] = (Rotation.from_rotvec(r).as_matrix() for r in (a, b))
    expected = np.degrees((Rotation.from_rotvec(a).inv() * Rotation.from_rotvec(b)).magnitude())
    assert rotation_error(one, two) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(
    ("a", "b", "degrees"),
    [([1, 0, 0], [2, 0, 0], 0), ([1, 0, 0], [-1, 0, 0], 180), ([1, 1, 0], [3, 0, 0], 45),
     ([0, 0, 0], [1, 0, 0], 90)],
)  # fmt: skip
def test_direction_error(a: list[float], b: list[float], degrees: float) -> None:
    one, two = np.eye(4), np.eye(4)
    one[:3, 3], two[:3, 3] = a, b
    assert direction_error(one, two) == pytest.approx(degrees)
