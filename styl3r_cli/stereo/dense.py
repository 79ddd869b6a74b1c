"""Depths where views overlap, from the photos themselves: the network's are only where to begin.

Once the cameras are exact, what two views show of a surface tells its depth to a fraction of a
pixel's parallax, which is more than a network's matches between cells of 8 pixels can know. What
two views' depths do not confirm stays as the network has it, but for what its neighbours moved.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.pointmap import pixel_centres
from styl3r_cli.cameras.poses import centre
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.cameras.two_view import rays
from styl3r_cli.gaussians import FloatArray
from styl3r_cli.meetings import ANOTHER, depths_at, project
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
        with np.errstate(all="ignore"):  # which counts for its own thread only
            return find_nearness(views[view], [views[other] for other in _nearest(views, view)])

    if len(views) < 2:
        return scene
    results = in_threads(find, list(views), threads)
    found = {view: each for view, each in zip(views, results, strict=True) if each is not None}
    points = {view: _points(nearness, views[view].camera) for view, nearness in found.items()}
    agreed = {view: _agreed(view, found, views, points) for view in found}
    confirmed = {view: each.confirmed for view, each in agreed.items()}
    made = copied(scene)
    for view, each in agreed.items():
        through = _looked_through(view, found, confirmed, views, points)
        certain = each.confirmed & (through < each.witnesses)
        if certain.any():
            factors = _factors(views[view].nearness, each.nearness, certain)
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


class Agreed(NamedTuple):
    """What views make of one view's depths; all (H, W).

    Attributes:
        nearness: inverse depths, each the mean of those of the views that have the same.
        witnesses: how many others have.
        confirmed: where any has, in patches; nowhere, if it is too seldom.
    """

    nearness: Array
    witnesses: NDArray[np.int64]
    confirmed: Mask


def _agreed(
    view: int, found: dict[int, Array], views: dict[int, View], points: dict[int, Array]
) -> Agreed:
    """Compare a view's inverse depths with the others'."""
    total, witnesses = np.log(found[view]), np.zeros(found[view].shape, np.int64)
    shown = np.zeros(found[view].shape, np.bool_)
    axis, shift = views[view].camera.extrinsics[2, :3], views[view].camera.extrinsics[2, 3]
    for other in found:
        if other == view:
            continue
        inside, at, depth = _seen_by(views[other].camera, points[view])
        there, surface = (
            cv2.remap(each.astype(np.float32), *at, cv2.INTER_LINEAR)
            for each in (found[other], points[other])
        )
        with np.errstate(all="ignore"):
            own = -np.log(surface @ axis + shift)  # of what the other sees, from here
            same = inside & (np.abs(there * depth - 1) < SAME) & np.isfinite(own)
        total += np.where(same, own, 0)
        witnesses += same
        shown |= inside
    nearness = np.exp(total / (witnesses + 1))
    confirmed = _in_patches(witnesses > 0, nearness)
    if confirmed.sum() < LEAST_SHARE * shown.sum():
        confirmed[:] = False
    return Agreed(nearness, witnesses, confirmed)


def _looked_through(
    view: int,
    found: dict[int, Array],
    confirmed: dict[int, Mask],
    views: dict[int, View],
    points: dict[int, Array],
) -> NDArray[np.int64]:
    """(H, W), how many others see something farther away where a view has a surface, for sure."""
    count = np.zeros(found[view].shape, np.int64)
    for other in found:
        if other != view:
            inside, at, depth = _seen_by(views[other].camera, points[view])
            sure = np.where(confirmed[other], found[other], np.inf).astype(np.float32)
            there = cv2.remap(sure, *at, cv2.INTER_NEAREST)
            with np.errstate(invalid="ignore"):
                count += inside & (there * depth < 1 - ANOTHER)
    return count


def _seen_by(camera: Camera, points: Array) -> tuple[Mask, tuple[FloatArray, FloatArray], Array]:
    """(H, W) whether points are in a camera's frame, where for OpenCV, and their depths."""
    x, y, depth = project(points, camera)
    inside = (x >= 0) & (x <= camera.width - 1) & (y >= 0) & (y <= camera.height - 1)
    column, row = (np.where(inside, each, 0).astype(np.float32) for each in (x, y))
    return inside, (column, row), depth


def _in_patches(mask: Mask, nearness: Array) -> Mask:
    """What is left of a mask without small patches of one surface."""
    most = np.iinfo(np.int16).max
    if not mask.any():
        return mask
    levels = nearness / np.median(nearness[mask]) * LEVELS
    levels = np.where(mask, levels.clip(1, most), 0).astype(np.int16)
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
