"""From Gaussians in the world to splats on the frame (EWA projection)."""

# numba infers the types of the kernels.
# mypy: allow-untyped-defs

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import FloatArray, Gaussians
from styl3r_cli.splatting.compiler import kernel, merged, parallel_for
from styl3r_cli.splatting.constants import (
    HALVINGS_PER_SQUARED_SIGMA,
    LOG2_CULL_MIN,
    LOG2_INVERSE_ALPHA_MIN,
    NEAR_FRACTION,
    PIXEL_CENTRE,
)
from styl3r_cli.splatting.ewa import (
    axis_limits,
    clamp,
    covariance,
    footprint,
    unit_quaternion,
    view_centre,
)

# Columns of a splat's record. At pixel offsets (dx, dy) from the centre (U, V) its alpha is
# 2^(LOG_OPACITY - p^2 - q^2) with p = A dx + B dy and q = C dy. This factored form of the inverse
# covariance stays exact for needles, where A dx^2 + 2 B dx dy + C dy^2 cancels catastrophically.
# A record fills one line of the cache.
U, V, A, B, C, LOG_OPACITY, Z, COLUMNS = 0, 1, 2, 3, 4, 5, 6, 8

VISIBLE, OUTSIDE, INVALID = 0, 1, 2

# Blending keeps depths in float32. Half of what that can hold: a weighted mean of depths rounds,
# and must not round to infinity.
FARTHEST = float(np.finfo(np.float32).max) / 2


@dataclass(frozen=True)
class Splats:
    """What one camera sees of G Gaussians.

    Attributes:
        records: (G, COLUMNS) float64, see the names of the columns; undefined where not visible.
        depths: (G,) float32, view z, by which splats are sorted.
        rects: (G, 4) int32, the pixels that bound a splat: first column and row, last column and
            row, all inclusive and within the frame.
        status: (G,) uint8: VISIBLE, OUTSIDE (of the frame, or invisible), INVALID.
    """

    records: NDArray[np.float64]
    depths: NDArray[np.float32]
    rects: NDArray[np.int32]
    status: NDArray[np.uint8]


def near_plane(means: FloatArray) -> float:
    """The nearest view z that is drawn, for a scene of these (G, 3) means.

    A fraction of the median distance from the scene's median point: the same for every camera
    (so that nothing pops along a path), for any order of the Gaussians, in any unit, and wherever
    the scene lies.
    """
    if not np.isfinite(means).all():
        means = means[np.isfinite(means).all(axis=1)]
    axes = np.ascontiguousarray(means.T)
    if axes.shape[1] == 0:
        return 0.0
    squares = np.zeros(axes.shape[1])
    for axis in axes:
        squares += (axis - _median(axis)) ** 2
    return NEAR_FRACTION * math.sqrt(_median(squares))


def _median(values: NDArray[np.floating]) -> np.float64:
    """The mean of the two middle values: np.median in a fifth of the time."""
    middle = len(values) // 2
    parted = np.partition(values, middle)
    upper = np.float64(parted[middle])
    return upper if len(values) % 2 else (upper + np.float64(parted[:middle].max())) / 2


def project(
    gaussians: Gaussians,
    camera: Camera,
    near: float,
    threads: int | None,
    antialias: bool = False,
) -> Splats:
    """Project Gaussians into a camera; view z up to ``near`` is not drawn.

    With ``antialias``, a splat that the dilation widens is made fainter, so that it weighs as much
    as before: sqrt(det / dilated det) (Mip-Splatting, arXiv 2311.16493, equation 9; the dilation
    stays the common one, as in gsplat).

    Raises:
        ValueError: if the camera is not finite or has no focal length or pixels.
    """
    count = len(gaussians)
    splats = Splats(
        np.empty((count, COLUMNS), np.float64),
        np.empty(count, np.float32),
        np.empty((count, 4), np.int32),
        np.empty(count, np.uint8),
    )
    parallel_for(
        _project, count, threads,
        gaussians.means, gaussians.scales, gaussians.rotations, gaussians.opacities,
        gaussians.colours, view_of(camera), tuple(lens_of(camera).tolist()), camera.height,
        camera.width, float(near), antialias,
        splats.records, splats.depths, splats.rects, splats.status,
    )  # fmt: skip
    return splats


def view_of(camera: Camera) -> tuple[float, ...]:
    """World to camera as the kernels take it: the first three rows, one after the other."""
    return tuple(np.asarray(camera.extrinsics, np.float64)[:3].ravel().tolist())


def lens_of(camera: Camera) -> NDArray[np.float64]:
    """Fx, fy, cx, cy of a camera, once it is known to be usable (ValueError if it is not)."""
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float64)
    if not (np.isfinite(lens).all() and np.isfinite(camera.extrinsics).all()):
        raise ValueError("the camera is not finite")
    if camera.fx <= 0 or camera.fy <= 0:
        raise ValueError(f"the camera's focal lengths are {camera.fx} and {camera.fy}, not > 0")
    if camera.width < 1 or camera.height < 1:
        raise ValueError(f"the camera's frame has {camera.width}x{camera.height} pixels")
    return lens


@merged
def _valid(i, means, scales, rotations, opacities, colours):
    """Whether Gaussian i is finite and describes an ellipsoid."""
    total = 0.0 + opacities[i]
    for k in range(3):
        total = total + means[i, k] + scales[i, k] + colours[i, k]  # float64, like total
        if scales[i, k] < 0:
            return False
    norm = 0.0
    for k in range(4):
        q = np.float64(rotations[i, k])
        total += q
        norm += q * q
    return math.isfinite(total) and norm > 0


@kernel
def _project(begin, end, means, scales, rotations, opacities, colours, view, lens,
             height, width, near, antialias, records, depths, rects,
             status):  # fmt: skip
    fx, fy, cx, cy = lens
    x_low, x_high = axis_limits(fx, cx, width)
    y_low, y_high = axis_limits(fy, cy, height)
    for index in range(begin, end):
        i = np.uintp(index)
        status[i] = OUTSIDE
        if not _valid(i, means, scales, rotations, opacities, colours):
            status[i] = INVALID
            continue
        slope_x, slope_y, z = view_centre(i, means, view)
        opacity = np.float64(opacities[i])
        if not (z > near and 0 < z < FARTHEST and opacity > 0):
            continue
        quaternion, _ = unit_quaternion(i, rotations)
        rows = footprint(
            view, quaternion,
            np.float64(scales[i, 0]), np.float64(scales[i, 1]), np.float64(scales[i, 2]),
            fx / z, fy / z, clamp(slope_x, x_low, x_high), clamp(slope_y, y_low, y_high),
        )  # fmt: skip
        xx, yy, xy, det, sharp = covariance(rows)
        if not math.isfinite(det + xx + yy):
            status[i] = INVALID
            continue
        log_opacity = math.log2(opacity)
        if antialias:
            log_opacity += 0.5 * math.log2(sharp / det)
        if not log_opacity > -LOG2_INVERSE_ALPHA_MIN:
            continue
        u, v = fx * slope_x + cx, fy * slope_y + cy
        reach = (log_opacity - LOG2_CULL_MIN) / HALVINGS_PER_SQUARED_SIGMA
        radius_x, radius_y = math.sqrt(reach * xx), math.sqrt(reach * yy)
        if not _touch(i, rects, u, v, radius_x, radius_y, width, height):
            continue
        a = math.sqrt(HALVINGS_PER_SQUARED_SIGMA * yy / det)
        records[i, U], records[i, V], records[i, Z] = u, v, z
        records[i, A], records[i, B] = a, -a * xy / yy
        records[i, C] = math.sqrt(HALVINGS_PER_SQUARED_SIGMA / yy)
        records[i, LOG_OPACITY] = log_opacity
        depths[i] = z
        status[i] = VISIBLE


@merged
def _touch(i, rects, u, v, radius_x, radius_y, width, height):
    """Note the pixels around a splat; False if no pixel's centre lies within its extent."""
    across, down = abs(u - 0.5 * width) - radius_x, abs(v - 0.5 * height) - radius_y
    if not (across <= 0.5 * width - PIXEL_CENTRE and down <= 0.5 * height - PIXEL_CENTRE):
        return False
    # Kept within the frame before they become integers, which cannot hold all that floats can.
    right, bottom = width - 1.0, height - 1.0
    x0 = math.ceil(clamp(u - radius_x - PIXEL_CENTRE, 0.0, right))
    y0 = math.ceil(clamp(v - radius_y - PIXEL_CENTRE, 0.0, bottom))
    x1 = math.floor(clamp(u + radius_x - PIXEL_CENTRE, 0.0, right))
    y1 = math.floor(clamp(v + radius_y - PIXEL_CENTRE, 0.0, bottom))
    rects[i, 0], rects[i, 1], rects[i, 2], rects[i, 3] = x0, y0, x1, y1
    return x0 <= x1 and y0 <= y1
