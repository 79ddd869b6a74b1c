"""EWA splatting's geometry, a Gaussian at a time: what the projection and its gradient share."""

# numba infers the types of the kernels.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np

from styl3r_cli.splatting.compiler import inlined, merged
from styl3r_cli.splatting.constants import DILATION, JACOBIAN_MARGIN


@inlined
def clamp(value, low, high):
    """The nearest value that is neither below nor above the bounds.

    numba compiles ``min`` and ``max`` anew for all types that they meet: a frame's worth of time.
    """
    return low if value < low else (high if value > high else value)


@merged
def axis_limits(focal, centre, length):
    """Range of x/z (or y/z) within which the projection's Jacobian is trusted."""
    margin = JACOBIAN_MARGIN * 0.5 * length / focal
    return -centre / focal - margin, (length - centre) / focal + margin


@merged
def view_centre(i, means, view):
    """A mean in the camera: x / z, y / z and z."""
    m0, m1, m2 = means[i, 0], means[i, 1], means[i, 2]  # become float64 when multiplied
    z = view[8] * m0 + view[9] * m1 + view[10] * m2 + view[11]
    x = view[0] * m0 + view[1] * m1 + view[2] * m2 + view[3]
    y = view[4] * m0 + view[5] * m1 + view[6] * m2 + view[7]
    nearness = 1 / z
    return x * nearness, y * nearness, z


@merged
def unit_quaternion(i, rotations):
    """A rotation as a quaternion w x y z of length 1, and the length that it had."""
    w, x = np.float64(rotations[i, 0]), np.float64(rotations[i, 1])
    y, z = np.float64(rotations[i, 2]), np.float64(rotations[i, 3])
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    scale = 1 / norm
    return (w * scale, x * scale, y * scale, z * scale), norm


@inlined
def to_matrix(w, x, y, z):
    """The (3, 3) rotation of a unit quaternion, row by row."""
    return (
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
        2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y),
    )  # fmt: skip


@inlined
def _axis(view, x, y, z, sigma, fx_z, fy_z, slope_x, slope_y):
    n0 = (view[0] * x + view[1] * y + view[2] * z) * sigma
    n1 = (view[4] * x + view[5] * y + view[6] * z) * sigma
    n2 = (view[8] * x + view[9] * y + view[10] * z) * sigma
    return fx_z * (n0 - slope_x * n2), fy_z * (n1 - slope_y * n2)


@merged
def footprint(view, quaternion, sx, sy, sz, fx_z, fy_z, slope_x, slope_y):
    """The frame's x and y (2, 3), in pixels, per sigma along each own axis."""
    qw, qx, qy, qz = quaternion
    r = to_matrix(qw, qx, qy, qz)
    x0, y0 = _axis(view, r[0], r[3], r[6], sx, fx_z, fy_z, slope_x, slope_y)
    x1, y1 = _axis(view, r[1], r[4], r[7], sy, fx_z, fy_z, slope_x, slope_y)
    x2, y2 = _axis(view, r[2], r[5], r[8], sz, fx_z, fy_z, slope_x, slope_y)
    return (x0, x1, x2), (y0, y1, y2)


@merged
def covariance(rows):
    """Dilated variances along x and y, their covariance, and the determinants with and without.

    The determinant as a sum of squares: the usual xx * yy - xy^2 cancels for needles.
    """
    (x0, x1, x2), (y0, y1, y2) = rows
    xx = x0 * x0 + x1 * x1 + x2 * x2
    yy = y0 * y0 + y1 * y1 + y2 * y2
    xy = x0 * y0 + x1 * y1 + x2 * y2
    m0 = x1 * y2 - x2 * y1
    m1 = x2 * y0 - x0 * y2
    m2 = x0 * y1 - x1 * y0
    sharp = m0 * m0 + m1 * m1 + m2 * m2
    det = sharp + DILATION * (xx + yy) + DILATION * DILATION
    return xx + DILATION, yy + DILATION, xy, det, sharp
