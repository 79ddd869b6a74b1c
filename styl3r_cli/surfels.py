"""Gaussians as discs that lie on the surfaces their views show (surfels)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.poses import to_quaternions
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.moved_views import copied, scale_depths
from styl3r_cli.pipeline import Scene

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# A disc's standard deviation along the surface, in distances to the next pixel's point: with less,
# windows of twice the size show gaps between the pixels, with 0.6 novel views are blurred (mean
# LPIPS of 26 fours of real photos 0.234; 0.223 with this, 0.237 with the network's round ones).
REACH = 0.5
# Pixels that one pixel's disc may span where the surface is steep, and how thick it is, in pixels.
# Neither matters much (LPIPS by 0.001 with 6, or 0.03); thick ones stand out at edges.
LONGEST, THICKNESS = 2.0, 0.1
# Gaussians that are more pixels wide fill what no view shows: the network has such ones along a
# picture's rim. By so large a part of their depth they go behind what others show there. (Without
# them viewers show black beside the views' frames: mean LPIPS of 29 pairs, on black, 0.320 instead
# of 0.297. In their place they blur what others show: 0.280 instead of 0.274 with holes filled.)
WIDE, BEHIND = 1.0, 0.15
# Neighbouring points are of one surface if their depths differ by no larger part.
SAME = 0.05


def surfels(scene: Scene, recovered: Recovered) -> Scene:
    """The scene with its Gaussians' scales and rotations by where their pixels' points are.

    The network's own are round. As in surface splatting (Zwicker et al. 2001), a disc covers what
    its pixel sees of the surface by its neighbours' points: it is longer where the surface is
    steep. Those at the rim of a picture, which are huge to fill what is beside it, stay so, a
    little farther away on their rays: else they would lie over what other views show there.

    Args:
        scene: from `locate_views`.
        recovered: its cameras. Views without one keep their Gaussians, and so do pixels that are
            at no finite depth in front of it.
    """
    made = copied(scene)
    for view in np.flatnonzero(recovered.recovered).tolist():
        points, camera = scene.means[view].astype(np.float64), recovered.cameras[view]
        with np.errstate(all="ignore"):
            depths = points @ camera.extrinsics[2, :3] + camera.extrinsics[2, 3]
            across, down = (_to_next(points, depths, camera, axis) for axis in (1, 0))
            axes, lengths = _disc(across, down)
            pixel = (depths / np.sqrt(camera.fx * camera.fy))[..., None]
            lengths = np.minimum(lengths, LONGEST * pixel)
            scales = np.concatenate([REACH * lengths, THICKNESS * pixel], axis=-1)
            rotations = to_quaternions(axes.reshape(-1, 3, 3)).reshape(*depths.shape, 4)
            seen = depths > 0
            wide = seen & (scene.scales[view].max(-1) > WIDE * pixel[..., 0])
        good = seen & ~wide & np.isfinite(scales).all(-1) & np.isfinite(rotations).all(-1)
        made.scales[view][good] = scales[good]
        made.rotations[view][good] = rotations[good]
        scale_depths(made, view, camera, np.where(wide, 1 + BEHIND, 1.0))
    return made


def _to_next(points: Array, depths: Array, camera: Camera, axis: int) -> Array:
    """(H, W, 3) from each pixel's point to the next one's along an axis of the picture.

    The mean of both sides, or the one that is of the same surface; else as if facing the camera.
    """
    focal = (camera.fy, camera.fx)[axis]
    facing = camera.extrinsics[1 - axis, :3] * (depths / focal)[..., None]
    steps = np.diff(points, axis=axis)
    nearer, farther = (np.take(depths, slice_, axis) for slice_ in _pairs(depths.shape[axis]))
    same = np.abs(farther - nearer) <= SAME * np.minimum(nearer, farther)
    total, count = np.zeros_like(points), np.zeros(depths.shape)
    for pixels in _pairs(depths.shape[axis]):
        where = (pixels, slice(None)) if axis == 0 else (slice(None), pixels)
        total[where] += np.where(same[..., None], steps, 0)
        count[where] += same
    return np.where(count[..., None] > 0, total / count[..., None], facing)


def _pairs(length: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of pixels that have a next one, and of those next ones."""
    return np.arange(length - 1), np.arange(1, length)


def _disc(across: Array, down: Array) -> tuple[Array, Array]:
    """The ellipse of two steps (H, W, 3) on a surface: its axes and their lengths.

    The outer products of the steps add up to a covariance; its axes within the surface follow from
    the 2x2 matrix of the steps' inner products.

    Returns:
        (H, W, 3, 3) a rotation whose columns are the long axis, the short one and the normal, and
        (H, W, 2) lengths of the first two.
    """
    a, b, c = ((x * y).sum(-1) for x, y in ((across, across), (across, down), (down, down)))
    angle = np.arctan2(2 * b, a - c)[..., None] / 2
    long = np.cos(angle) * across + np.sin(angle) * down
    normal = _unit(np.cross(across, down))
    first = _unit(long)
    axes = np.stack([first, np.cross(normal, first), normal], axis=-1)
    half, spread = (a + c) / 2, np.hypot((a - c) / 2, b)
    squares = np.stack([half + spread, np.maximum(half - spread, 0)], axis=-1)
    return axes, np.sqrt(squares)


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
