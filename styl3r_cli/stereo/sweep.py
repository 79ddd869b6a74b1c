"""One view's depths: planes swept through all of its scene, then small steps around the best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import FloatArray
from styl3r_cli.stereo.costs import Look, plane_costs, resized, surface_costs
from styl3r_cli.stereo.semiglobal import best_labels

Array = NDArray[np.float64]

# The sweep's pictures are so much smaller than the views. On 26 fours of real photos new views'
# mean LPIPS is 0.259 without stereo, 0.249, 0.247 and 0.245 with 1/2, 5/8 and 3/4, and 0.244 with
# pictures as large as the views and no second stage, which takes four times as long.
SWEPT_SIZE = 0.75
# Planes lie so many pixels of those pictures apart; so many there are, at least and at most (which
# bounds memory and time: wide baselines get larger steps).
PLANE_STEP, FEWEST_PLANES, MOST_PLANES = 1.0, 24, 128
# Depths are sought so far beyond the fiftieth part that is nearest and farthest already.
MARGIN, RIM = 0.3, 2.0  # a part, and a percentage
# What it costs at most to leave the depths that are known already, and by which part of them.
HOLD, HOLD_WIDTH = 0.05, 0.08
# The best plane must cost so much less than planes do on average: along stripes, and on bare walls,
# all look alike.
LEAST_CONTRAST = 0.03
# Then up to so many steps, of so many of the view's pixels, nearer and farther.
STEPS, STEP = 4, 0.5
# A view's points move less than so many pixels between the nearest and the farthest depth: then
# no depth can be told from another.
LEAST_MOTION = 2.0
PROBES, PROBED_DEPTHS = 5, 9  # pixels along each side, and depths, that motion is measured at


@dataclass(frozen=True)
class View:
    """What stereo knows of a view.

    Attributes:
        picture: (h, w, 3) uint8 RGB, of any size.
        camera: its frame is (H, W).
        nearness: (H, W) inverse depths so far; NaN where unknown.
    """

    picture: NDArray[np.uint8]
    camera: Camera
    nearness: Array

    def look(self, size: tuple[int, int]) -> Look:
        """Its picture and camera at (height, width)."""
        return Look.of(self.picture, self.camera, size)

    def colours(self, size: tuple[int, int]) -> FloatArray:
        """(height, width, 3) in [0, 1]."""
        return resized(self.picture, size).astype(np.float32) / np.float32(255)


def find_nearness(view: View, others: Sequence[View]) -> Array | None:
    """(H, W) inverse depths at which other views look most like a view; NaN where all look alike.

    Args:
        view: whose.
        others: views with other centres that show the same.

    Returns:
        None where nothing can be told: no depth is known, or the cameras hardly moved.
    """
    known = view.nearness[view.nearness > 0]
    if not known.size:
        return None
    near, far = np.percentile(known, [100 - RIM, RIM])
    near, far = near * (1 + MARGIN), far * (1 - MARGIN)
    pixels = motion(view.camera, [other.camera for other in others], far, near)
    if not LEAST_MOTION <= pixels < np.inf:
        return None
    rough, told = _swept(view, others, np.array([far, near]), pixels)
    found = _stepped(view, others, rough, (near - far) / pixels * STEP)
    found = np.maximum(found, far / 2)  # small steps from far away would lead beyond infinity
    height, width = found.shape
    tells = np.asarray(cv2.resize(told, (width, height), interpolation=cv2.INTER_NEAREST))
    return np.where(tells > 0, found, np.nan)


def _swept(
    view: View, others: Sequence[View], limits: Array, pixels: float
) -> tuple[FloatArray, NDArray[np.uint8]]:
    """(h, w) inverse depths between two limits, by planes, and whether costs tell any.

    `pixels` is what points move between the limits.
    """
    height, width = (round(SWEPT_SIZE * side) for side in view.nearness.shape)
    size = height, width
    count = int(np.clip(SWEPT_SIZE * pixels / PLANE_STEP, FEWEST_PLANES, MOST_PLANES))
    planes = np.linspace(limits[0], limits[1], count)
    costs = plane_costs(view.look(size), [other.look(size) for other in others], planes)
    told = costs.mean(axis=0) - costs.min(axis=0) > LEAST_CONTRAST
    usual = float(np.median(view.nearness[view.nearness > 0]))
    so_far = np.where(view.nearness > 0, view.nearness, usual).astype(np.float32)
    so_far = np.asarray(cv2.resize(so_far, (width, height), interpolation=cv2.INTER_AREA))
    for plane, cost in zip(planes, costs, strict=True):
        away = np.abs(np.log(np.float32(plane) / so_far)) / np.float32(HOLD_WIDTH)
        cost += np.float32(HOLD) * np.minimum(away, 1)
    labels = best_labels(costs, view.colours(size))
    nearness = np.interp(labels, np.arange(count), planes).astype(np.float32)
    return nearness, told.astype(np.uint8)


def _stepped(view: View, others: Sequence[View], rough: FloatArray, step: float) -> Array:
    """(H, W) inverse depths around rough ones, by small steps of each pixel's."""
    height, width = view.nearness.shape
    size = height, width
    # Nearest: between two surfaces there is none.
    start = np.asarray(cv2.resize(rough, (width, height), interpolation=cv2.INTER_NEAREST))
    steps = (np.arange(-STEPS, STEPS + 1) * step).astype(np.float32)
    looks = [other.look(size) for other in others]
    costs = surface_costs(view.look(size), looks, start.astype(np.float32), steps)
    labels = best_labels(costs, view.colours(size))
    return start + (labels - STEPS) * step


def motion(camera: Camera, others: Sequence[Camera], far: float, near: float) -> float:
    """Pixels that points typically move in another view between two inverse depths of a view.

    In the one where they move most; 0 where none sees anything of them.
    """
    grid = (np.arange(PROBES) + 0.5) / PROBES
    u, v = np.meshgrid(grid * camera.width, grid * camera.height)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(camera.intrinsics).T
    planes = np.linspace(far, near, PROBED_DEPTHS)[:, None, None, None]
    most = 0.0
    for other in others:
        move = other.extrinsics @ np.linalg.inv(camera.extrinsics)
        seen = (rays @ move[:3, :3].T + move[:3, 3] * planes) @ other.intrinsics.T
        with np.errstate(all="ignore"):
            places = np.where(seen[..., 2:] > 0, seen[..., :2] / seen[..., 2:], np.nan)
        ways = np.linalg.norm(np.diff(places, axis=0), axis=-1).sum(axis=0)
        ways = ways[np.isfinite(ways)]
        if ways.size:
            most = max(most, float(np.median(ways)))
    return most
