"""Bundle adjustment of a few cameras, their lens, and smooth corrections to the depths they see.

Levenberg and Marquardt's least squares with Cauchy's robust weights (Triggs et al. 2000, "Bundle
Adjustment: A Modern Synthesis").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.pose_errors import motion

Array = NDArray[np.float64]

# What cameras and depths are off by before: radians, steps in units of length, parts of nearness.
# All wide: they hold what no sighting says anything about.
TURN, STEP, BEND = np.radians(3), 0.2, 0.1
# And a focal length that was guessed: its logarithm. Most phones' are within it of 28 mm.
ZOOM = 0.2
MOST_ROUNDS = 12
ENOUGH = 1e-3  # of the cost: rounds that gain less are the last
FIRST_DAMPING, MOST_DAMPING, LEAST_DAMPING = 1e-3, 1e5, 1e-6
# Places beside or behind a camera count as if they were that far before it (of their own distance).
LEAST_DEPTH = 1e-3
POSE = 6  # unknowns of a camera: a turn, then a step


@dataclass(frozen=True)
class Sightings:
    """Where a view's places are seen by another.

    Attributes:
        view: whose places they are.
        other: who sees them.
        rays: (M, 3) towards them in the view's frame, z = 1.
        nearness: (M,) inverse depths that the view has there.
        bends: (M, Q) what each of the view's Q coefficients adds to these.
        seen: (M, 2) x / z and y / z in the other's frame.
        along: (M, 2) unit, the direction in which the other sees places move as depth changes.
        sigmas: (M, 2) standard deviations along it and across it, as `seen`.
    """

    view: int
    other: int
    rays: Array
    nearness: Array
    bends: Array
    seen: Array
    along: Array
    sigmas: Array


class Adjusted(NamedTuple):
    """What explains sightings best.

    Attributes:
        extrinsics: (N, 4, 4).
        coefficients: (N, Q) of each view's bends.
        zoom: logarithm of what all views' focal lengths are to be multiplied by.
    """

    extrinsics: Array
    coefficients: Array
    zoom: float = 0.0


@np.errstate(all="ignore")  # numbers beyond float64 make no step better, and none is taken
def adjust(
    sightings: Sequence[Sightings], extrinsics: Array, unit: float, any_lens: bool = False
) -> Adjusted:
    """Cameras and coefficients that explain sightings best; the first camera stays.

    Args:
        sightings: of all views.
        extrinsics: (N, 4, 4) to begin with; what the sightings leave open stays near them.
        unit: length of a typical step between cameras.
        any_lens: whether the focal lengths were guessed; else they stay.

    Returns:
        What it began with, where no step is any better.
    """
    now = Adjusted(extrinsics, np.zeros((len(extrinsics), sightings[0].bends.shape[1])))
    spread = _spread(now, unit)
    moved = np.zeros(len(spread))  # all changes so far, added up: they are small
    free = np.arange(len(spread) if any_lens else len(spread) - 1)
    cost, damping = _cost(sightings, now) + _held(moved, spread), FIRST_DAMPING
    for _ in range(MOST_ROUNDS):
        matrix, slope = _normal_equations(sightings, now)
        matrix += np.diag(1 / spread**2)
        slope += moved / spread**2
        while True:
            damped = matrix + damping * np.diag(np.diag(matrix))
            change = np.zeros(len(spread))
            change[free] = -np.linalg.solve(damped[np.ix_(free, free)], slope[free])
            tried = _changed(now, change)
            reached = _cost(sightings, tried) + _held(moved + change, spread)
            if reached < cost or damping > MOST_DAMPING:
                break
            damping *= 10
        if not reached < cost:
            break
        gained = cost - reached
        now, moved, cost, damping = tried, moved + change, reached, max(damping / 10, LEAST_DAMPING)
        if gained < ENOUGH * cost:
            break
    return now


@np.errstate(all="ignore")
def misfit(sightings: Sequence[Sightings], adjusted: Adjusted) -> float:
    """The robust cost of sightings: what the adjustment makes small."""
    return _cost(sightings, adjusted)


def _spread(adjusted: Adjusted, unit: float) -> Array:
    """Standard deviations of all unknowns before anything is seen."""
    views, bends = adjusted.coefficients.shape
    pose = np.repeat([TURN, STEP * unit], 3)
    return np.concatenate([np.tile(pose, views - 1), np.full(views * bends, BEND), [ZOOM]])


def _held(moved: Array, spread: Array) -> float:
    return float(np.square(moved / spread).sum())


def _changed(now: Adjusted, change: Array) -> Adjusted:
    """After small turns and steps in the cameras' own frames."""
    views = len(now.extrinsics)
    poses = change[: POSE * (views - 1)].reshape(-1, POSE)
    extrinsics = now.extrinsics.copy()
    for view, pose in enumerate(poses, 1):
        small = np.eye(4)
        small[:3, :3], small[:3, 3] = cv2.Rodrigues(pose[:3])[0], pose[3:]
        extrinsics[view] = small @ extrinsics[view]
    bends = change[POSE * (views - 1) : -1].reshape(views, -1)
    return Adjusted(extrinsics, now.coefficients + bends, now.zoom + float(change[-1]))


def _cost(sightings: Sequence[Sightings], adjusted: Adjusted) -> float:
    return sum(float(np.log1p(np.square(_look(each, adjusted)[0])).sum()) for each in sightings)


def _look(each: Sightings, now: Adjusted) -> tuple[Array, Array, Array]:
    """How far off sightings are, in sigmas (M, 2), the places times nearness (M, 3), nearness."""
    move = motion(now.extrinsics[each.view], now.extrinsics[each.other])
    nearness = each.nearness + each.bends @ now.coefficients[each.view]
    places = _zoomed(each.rays, now.zoom) @ move[:3, :3].T + nearness[:, None] * move[:3, 3]
    flat = places[:, :2] / np.maximum(places[:, 2:], LEAST_DEPTH)
    off = flat * np.exp(now.zoom) - each.seen
    along, across = (off * each.along).sum(1), (off * _across(each.along)).sum(1)
    return np.stack([along, across], axis=1) / each.sigmas, places, nearness


def _zoomed(rays: Array, zoom: float) -> Array:
    """Rays of the same pixels through a longer lens."""
    narrower = np.exp(-zoom)
    return rays * np.array([narrower, narrower, 1.0])


def _across(along: Array) -> Array:
    return np.stack([-along[:, 1], along[:, 0]], axis=1)


def _normal_equations(sightings: Sequence[Sightings], now: Adjusted) -> tuple[Array, Array]:
    """Gauss and Newton's matrix and gradient (both over two) of the sightings' cost."""
    views, bends = now.coefficients.shape
    unknowns = POSE * (views - 1) + bends * views + 1
    matrix, slope = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
    for each in sightings:
        off, places, nearness = _look(each, now)
        slopes = _slopes(each, now, places, nearness)
        at = np.concatenate(
            [
                np.arange(POSE) + POSE * (each.view - 1),
                np.arange(POSE) + POSE * (each.other - 1),
                np.arange(bends) + POSE * (views - 1) + bends * each.view,
                [unknowns - 1],
            ]
        )
        free = at >= 0  # the first camera is not
        at, slopes = at[free], slopes[..., free].reshape(-1, int(free.sum()))
        weights = 1 / (1 + np.square(off.ravel()))
        weighted = slopes.T * weights
        matrix[np.ix_(at, at)] += weighted @ slopes
        slope[at] += weighted @ off.ravel()
    return matrix, slope


def _slopes(each: Sightings, now: Adjusted, places: Array, nearness: Array) -> Array:
    """(M, 2, 2 POSE + Q + 1) how `_look`'s first result changes with all that it depends on.

    Either camera, the bends, and the zoom.
    """
    move = motion(now.extrinsics[each.view], now.extrinsics[each.other])
    turn, step = move[:3, :3], move[:3, 3]
    rays = _zoomed(each.rays, now.zoom)
    depth = np.maximum(places[:, 2:], LEAST_DEPTH)
    flat = places[:, :2] / depth
    axes = np.stack([each.along, _across(each.along)], axis=1) / each.sigmas[:, :, None]
    axes *= np.exp(now.zoom)
    outwards = (axes * flat[:, None]).sum(2, keepdims=True)
    # Row by row, how the result changes with the place: each of the rest is one product with it.
    there = np.concatenate([axes, -outwards], axis=2) / depth[:, None]
    here = there @ turn
    size = nearness[:, None, None]
    return np.concatenate(
        [
            np.cross(here, rays[:, None]),
            -size * here,
            -np.cross(there, places[:, None]),
            size * there,
            (there @ step)[..., None] * each.bends[:, None],
            outwards - (here[..., :2] * rays[:, None, :2]).sum(2, keepdims=True),
        ],
        axis=2,
    )
