"""Depths where views overlap, from the photos themselves: the network's are only where to begin.

Once the cameras are exact, what two views show of a surface tells its depth to a fraction of a
pixel's parallax, which is more than a network's matches between cells of 8 pixels can know. What
two views' depths do not confirm stays as the network has it, but for what its neighbours moved.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.pointmap import pixel_centres
from styl3r_cli.cameras.poses import centre
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.cameras.two_view import rays
from styl3r_cli.meetings import depths_at, project
from styl3r_cli.moved_views import copied, scale_depths
from styl3r_cli.pipeline import Scene
from styl3r_cli.stereo.sweep import View, find_nearness
from styl3r_cli.threads import in_threads

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# A view is compared with so many others, those that stand nearest: two are hardly worse (4 views,
# AbsRel 0.078 instead of 0.077), more take longer.
MOST_OTHERS = 3
# Two views' depths confirm each other if they differ by no larger part.
SAME = 0.05
# Fewer pixels together that are confirmed are so by chance; within such patches inverse depths
# change by less than a part of the median from one pixel to the next.
FEWEST_PIXELS, SMOOTH = 200, 0.02
# Of what another view's frame shows, such a part must be confirmed. Of 90 real views two thirds
# are, of views whose camera is wrong about a fifth, by chance.
LEAST_SHARE = 0.25
# Around confirmed pixels others move along: standard deviation of their say, in pixels, and what
# their absence weighs.
REACH, ABSENCE = 9.0, 0.05
LEVELS = 1000.0  # inverse depths of OpenCV's speckle filter are whole numbers: so many a median


def dense(
    scene: Scene,
    recovered: Recovered,
    pictures: Sequence[NDArray[np.uint8]],
    threads: int | None = None,
) -> Scene:
    """The scene with its Gaussians moved along their rays, to where views look alike.

    Views of which too little is confirmed stay as they are. Same input, same result, at any
    number of threads.

    Args:
        scene: from `Stylizer.encode`.
        recovered: its cameras; views without are left out.
        pictures: N times (h, w, 3) RGB of what the views show, of any size each.
        threads: None for every core.
    """
    views = {
        view: View(
            pictures[view],
            recovered.cameras[view],
            _nearness(scene.means[view], recovered.cameras[view]),
        )
        for view in np.flatnonzero(recovered.recovered).tolist()
    }

    def find(view: int) -> Array | None:
        return find_nearness(views[view], [views[other] for other in _nearest(views, view)])

    if len(views) < 2:
        return scene
    with np.errstate(all="ignore"):
        results = in_threads(find, list(views), threads)
    found = {view: each for view, each in zip(views, results, strict=True) if each is not None}
    points = {view: _points(nearness, views[view].camera) for view, nearness in found.items()}
    made = copied(scene)
    for view in found:
        agreed, confirmed = _agreed(view, found, views, points)
        if confirmed.any():
            factors = _factors(views[view].nearness, agreed, confirmed)
            scale_depths(made, view, views[view].camera, factors)
    return made


def _nearness(points: NDArray[np.floating], camera: Camera) -> Array:
    """(H, W) inverse depths of a view's points; NaN where they are not before its camera."""
    pixels = pixel_centres(*points.shape[:2]).reshape(-1, 2)
    with np.errstate(all="ignore"):
        nearness = 1 / depths_at(points.astype(np.float32), camera.extrinsics, pixels)
    good = (nearness > 0) & np.isfinite(nearness)
    return np.where(good, nearness, np.nan).reshape(points.shape[:2])


def _nearest(views: dict[int, Any], view: int) -> list[int]:
    """The other views that stand nearest to one, nearest first."""
    eye = centre(views[view].camera.extrinsics)
    others = [other for other in views if other != view]

    def distance(other: int) -> float:
        return float(np.linalg.norm(centre(views[other].camera.extrinsics) - eye))

    return sorted(others, key=distance)[:MOST_OTHERS]


def _points(nearness: Array, camera: Camera) -> Array:
    """(H, W, 3) what a view's pixels show at (H, W) inverse depths."""
    flat = rays(pixel_centres(*nearness.shape).reshape(-1, 2), camera.intrinsics)
    seen = flat / nearness.reshape(-1, 1)
    turn, shift = camera.extrinsics[:3, :3], camera.extrinsics[:3, 3]
    return ((seen - shift) @ turn).reshape(*nearness.shape, 3)


def _agreed(
    view: int, found: dict[int, Array], views: dict[int, View], points: dict[int, Array]
) -> tuple[Array, Mask]:
    """A view's inverse depths (H, W), each the mean of those of the views that have the same.

    And where any other has; nowhere, if it is too seldom.
    """
    height, width = found[view].shape
    total, count = np.log(found[view]), np.ones((height, width))
    shown = np.zeros((height, width), np.bool_)
    axis, shift = views[view].camera.extrinsics[2, :3], views[view].camera.extrinsics[2, 3]
    for other in found:
        if other == view:
            continue
        x, y, depth = project(points[view], views[other].camera)
        inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        at = [np.where(inside, each, 0).astype(np.float32) for each in (x, y)]
        there, surface = (
            cv2.remap(each.astype(np.float32), at[0], at[1], cv2.INTER_LINEAR)
            for each in (found[other], points[other])
        )
        with np.errstate(all="ignore"):
            own = -np.log(surface @ axis + shift)  # of what the other sees, from here
            same = inside & (np.abs(there * depth - 1) < SAME) & np.isfinite(own)
        total += np.where(same, own, 0)
        count += same
        shown |= inside
    nearness = np.exp(total / count)
    confirmed = _in_patches(count > 1, nearness)
    if confirmed.sum() < LEAST_SHARE * shown.sum():
        confirmed[:] = False
    return nearness, confirmed


def _in_patches(mask: Mask, nearness: Array) -> Mask:
    """What is left of a mask without small patches of one surface."""
    most = np.iinfo(np.int16).max
    levels = (nearness / np.median(nearness) * LEVELS).clip(1, most).astype(np.int16)
    levels[~mask] = 0
    cv2.filterSpeckles(levels, 0, FEWEST_PIXELS, SMOOTH * LEVELS)
    return levels > 0


def _factors(before: Array, after: Array, confirmed: Mask) -> Array:
    """(H, W) what depths are to be multiplied by."""
    good = confirmed & np.isfinite(before)
    with np.errstate(all="ignore"):
        change = np.where(good, np.log(before / after), 0).astype(np.float32)
    say = cv2.GaussianBlur(good.astype(np.float32), (0, 0), REACH) + np.float32(ABSENCE)
    around = np.asarray(cv2.GaussianBlur(change, (0, 0), REACH)) / say
    return np.exp(np.where(good, change, around).astype(np.float64))
