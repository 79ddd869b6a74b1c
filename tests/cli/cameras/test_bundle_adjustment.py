"""Bundle adjustment against SciPy's least squares, and against cameras that are known."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from styl3r_cli.cameras.bundle import BEND, STEP, TURN, ZOOM, Sightings, adjust
from styl3r_cli.cameras.pose_errors import rotation_error

Array = NDArray[np.float64]
VIEWS, PLACES, BENDS = 3, 60, 2
SIGMA = 0.001


def pose(numbers: Array) -> Array:
    """(4, 4) of a rotation vector and a shift."""
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = cv2.Rodrigues(numbers[:3])[0], numbers[3:]
    return made


def true_poses() -> Array:
    return np.stack(
        [pose(np.array([0.02, -0.1, 0.03, -1, 0.1, 0.05]) * view) for view in range(VIEWS)]
    )


def sights(noise: float = 0.0, wild: int = 0, lens: float = 1.0) -> list[Sightings]:
    """What each view sees of the others' places, whose depths it has 4 % too large.

    Its focal length is `lens` times what it is taken for.
    """
    random, poses, found = np.random.default_rng(0), true_poses(), []
    for view in range(VIEWS):
        rays = np.column_stack([random.uniform(-0.4, 0.4, (PLACES, 2)), np.ones(PLACES)])
        depth = random.uniform(3, 6, PLACES)
        for other in range(VIEWS):
            if other == view:
                continue
            move = poses[other] @ np.linalg.inv(poses[view])
            place = (rays * depth[:, None]) @ move[:3, :3].T + move[:3, 3]
            seen = place[:, :2] / place[:, 2:] + noise * random.normal(size=(PLACES, 2))
            seen[:wild] += random.uniform(-0.5, 0.5, (wild, 2))
            near = 1 / (1.04 * depth)
            along = random.normal(size=(PLACES, 2))
            along /= np.linalg.norm(along, axis=1)[:, None]
            sigmas = SIGMA * np.column_stack([np.full(PLACES, 2.0), np.ones(PLACES)])
            bends = np.column_stack([near, near * rays[:, 0]])
            wide, seen = rays * [lens, lens, 1.0], seen * lens
            found.append(Sightings(view, other, wide, near, bends, seen, along, sigmas))
    return found


def wrong_poses() -> Array:
    random, poses = np.random.default_rng(1), true_poses()
    for view in range(1, VIEWS):
        poses[view] = pose(random.normal(size=6) * [0.01] * 6) @ poses[view]
    return poses


def test_it_finds_the_cameras_and_depths() -> None:
    found = adjust(sights(), wrong_poses(), 1.0)
    poses = true_poses()
    np.testing.assert_array_equal(found.extrinsics[0], poses[0])
    for view in range(1, VIEWS):
        assert rotation_error(found.extrinsics[view], poses[view]) < 0.02
        # Sightings leave the world's size open: only what it was before holds it.
        size = np.linalg.norm(found.extrinsics[view][:3, 3]) / np.linalg.norm(poses[view][:3, 3])
        np.testing.assert_allclose(
            found.extrinsics[view][:3, 3], size * poses[view][:3, 3], atol=2e-3
        )
        near = 1 / 1.04 * (1 + found.coefficients[view, 0])
        assert near * size == pytest.approx(1, abs=2e-3)


@pytest.mark.parametrize("lens", [0.87, 1.2])
def test_it_finds_a_lens_that_was_guessed(lens: float) -> None:
    found = adjust(sights(lens=lens), wrong_poses(), 1.0, any_lens=True)
    assert np.exp(found.zoom) == pytest.approx(lens, rel=0.01)
    poses = true_poses()
    assert max(rotation_error(found.extrinsics[k], poses[k]) for k in (1, 2)) < 0.1
    assert adjust(sights(lens=lens), wrong_poses(), 1.0).zoom == 0


@pytest.mark.parametrize("any_lens", [False, True])
def test_it_reaches_the_least_cost_that_scipy_finds(any_lens: bool) -> None:
    """The robust cost and what holds the unknowns, written anew with rotation vectors."""
    seen, start = sights(noise=SIGMA, wild=9, lens=1.1 if any_lens else 1.0), wrong_poses()
    spread = np.concatenate(
        [np.tile(np.repeat([TURN, STEP], 3), VIEWS - 1), np.full(6, BEND), [ZOOM] * any_lens]
    )

    def off(unknown: Array) -> Array:
        poses = [start[0]]
        poses += [pose(unknown[6 * k : 6 * k + 6]) @ start[k + 1] for k in range(VIEWS - 1)]
        coefficients = unknown[6 * (VIEWS - 1) :][:6].reshape(VIEWS, BENDS)
        zoom = np.exp(unknown[-1]) if any_lens else 1.0
        parts = []
        for each in seen:
            depth = 1 / (each.nearness + each.bends @ coefficients[each.view])
            world = np.linalg.inv(poses[each.view]) @ np.vstack(
                [(each.rays / [zoom, zoom, 1] * depth[:, None]).T, np.ones(PLACES)]
            )
            place = (poses[each.other] @ world)[:3]
            gap = (place[:2] / place[2]).T * zoom - each.seen
            other = np.stack([-each.along[:, 1], each.along[:, 0]], axis=1)
            both = np.stack([(gap * axis).sum(1) for axis in (each.along, other)], axis=1)
            parts.append((both / each.sigmas).ravel())
        return np.concatenate(parts)

    def cost(unknown: Array) -> float:
        return float(np.log1p(np.square(off(unknown))).sum() + np.square(unknown / spread).sum())

    def root(unknown: Array) -> Array:  # whose squares sum to the cost
        return np.concatenate([np.sqrt(np.log1p(np.square(off(unknown)))), unknown / spread])

    ours = adjust(seen, start, 1.0, any_lens)
    moved = [
        now @ np.linalg.inv(before) for now, before in zip(ours.extrinsics, start, strict=True)
    ]
    unknown = np.concatenate(
        [np.append(cv2.Rodrigues(m[:3, :3])[0][:, 0], m[:3, 3]) for m in moved[1:]]
        + [ours.coefficients.ravel(), [ours.zoom] * any_lens]
    )
    theirs = least_squares(root, unknown, x_scale="jac")
    assert cost(unknown) < 0.5 * cost(np.zeros_like(spread))
    assert cost(unknown) < 1.002 * cost(theirs.x)


@pytest.mark.parametrize("size", [1e200, 1e-200])
@pytest.mark.filterwarnings("error")
def test_numbers_beyond_all_measure_change_nothing_or_stay_finite(size: float) -> None:
    seen = [replace(each, nearness=each.nearness * size) for each in sights()]
    found = adjust(seen, wrong_poses(), 1.0, any_lens=True)
    assert np.isfinite(found.extrinsics).all()
    assert np.isfinite(found.coefficients).all()
    assert np.isfinite(found.zoom)


def test_wild_sightings_do_not_decide() -> None:
    poses = true_poses()
    found = adjust(sights(noise=SIGMA / 2, wild=20), wrong_poses(), 1.0)
    assert max(rotation_error(found.extrinsics[k], poses[k]) for k in (1, 2)) < 0.1


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_the_unit_of_length_plays_no_part(unit: float) -> None:
    seen, start = sights(noise=SIGMA), wrong_poses()
    scaled = [
        Sightings(
            each.view, each.other, each.rays, each.nearness / unit, each.bends / unit,
            each.seen, each.along, each.sigmas,
        )
        for each in seen
    ]  # fmt: skip
    far = start.copy()
    far[:, :3, 3] *= unit
    one, other = adjust(seen, start, 1.0), adjust(scaled, far, unit)
    np.testing.assert_allclose(other.extrinsics[:, :3, :3], one.extrinsics[:, :3, :3], atol=1e-9)
    np.testing.assert_allclose(
        other.extrinsics[:, :3, 3] / unit, one.extrinsics[:, :3, 3], atol=1e-9
    )
