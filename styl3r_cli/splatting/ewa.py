"""EWA splatting's geometry, a Gaussian at a time: what the projection and its gradient share."""

# numba infers the types of the kernels.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np

from styl3r_cli.splatting.compiler import inlined
from styl3r_cli.splatting.constants import DILATION, JACOBIAN_MARGIN


@inlined
def clamp(value, low, high):
    """The nearest value that is neither below nor above the bounds.

    numba compiles ``min`` and ``max`` anew for all types that they meet: a frame's worth of time.
    """
    return low if value < low else (high if value > high else value)


@inlined
def axis_limits(focal, centre, length):
    """Range of x/z (or y/z) within which the projection's Jacobian is trusted."""
    margin = JACOBIAN_MARGIN * 0.5 * length / focal
    return -centre / focal - margin, (length - centre) / focal + margin


@inlined
def view_centre(i, means, view):
    """A mean in the camera: x / z, y / z and z."""
    m0, m1, m2 = np.float64(means[i, 0]), np.float64(means[i, 1]), np.float64(means[i, 2])
    z = view[2, 0] * m0 + view[2, 1] * m1 + view[2, 2] * m2 + view[2, 3]
    x = view[0, 0] * m0 + view[0, 1] * m1 + view[0, 2] * m2 + view[0, 3]
    y = view[1, 0] * m0 + view[1, 1] * m1 + view[1, 2] * m2 + view[1, 3]
    nearness = 1 / z
    return x * nearness, y * nearness, z


@inlined
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
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip


@inlined
def footprint(view, quaternion, sx, sy, sz, fx_z, fy_z, slope_x, slope_y, rows):
    """Fill ``rows`` (2, 3): the frame's x and y, in pixels, per sigma along each own axis."""
    qw, qx, qy, qz = quaternion
    r = to_matrix(qw, qx, qy, qz)
    for k in range(3):
        scale = sx if k == 0 else (sy if k == 1 else sz)
        n0 = (view[0, 0] * r[k] + view[0, 1] * r[3 + k] + view[0, 2] * r[6 + k]) * scale
        n1 = (view[1, 0] * r[k] + view[1, 1] * r[3 + k] + view[1, 2] * r[6 + k]) * scale
        n2 = (view[2, 0] * r[k] + view[2, 1] * r[3 + k] + view[2, 2] * r[6 + k]) * scale
        rows[0, k] = fx_z * (n0 - slope_x * n2)
        rows[1, k] = fy_z * (n1 - slope_y * n2)


@inlined
def covariance(rows):
    """Dilated variances along x and y, their covariance, and the determinants with and without.

    The determinant as a sum of squares: the usual xx * yy - xy^2 cancels for needles.
    """
    xx = rows[0, 0] ** 2 + rows[0, 1] ** 2 + rows[0, 2] ** 2
    yy = rows[1, 0] ** 2 + rows[1, 1] ** 2 + rows[1, 2] ** 2
    xy = rows[0, 0] * rows[1, 0] + rows[0, 1] * rows[1, 1] + rows[0, 2] * rows[1, 2]
    m0 = rows[0, 1] * rows[1, 2] - rows[0, 2] * rows[1, 1]
    m1 = rows[0, 2] * rows[1, 0] - rows[0, 0] * rows[1, 2]
    m2 = rows[0, 0] * rows[1, 1] - rows[0, 1] * rows[1, 0]
    sharp = m0 * m0 + m1 * m1 + m2 * m2
    det = sharp + DILATION * (xx + yy) + DILATION * DILATION
    return xx + DILATION, yy + DILATION, xy, det, sharp
