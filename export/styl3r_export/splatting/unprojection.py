"""From gradients of splats on the frame to gradients of Gaussians in the world."""

# numba infers the types of the kernels.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np

from styl3r_cli.splatting.compiler import inlined, kernel
from styl3r_cli.splatting.ewa import (
    axis_limits,
    clamp,
    covariance,
    footprint,
    to_matrix,
    unit_quaternion,
    view_centre,
)
from styl3r_cli.splatting.projection import VISIBLE, A, B, C
from styl3r_export.splatting.gradients import (
    DEPTH,
    G_DY,
    G_DY_DY,
    G_P,
    G_P_DX,
    G_P_DY,
    RED,
    SUMS,
    G,
)


@inlined
def _shape_gradient(sums, a, b, c, rows, g_rows):
    """Fill ``g_rows`` (2, 3), the gradient of the footprint, through A, B, C and the covariance."""
    xx, yy, xy, det, _ = covariance(rows)
    rows_x, rows_y = rows
    g_a, g_b, g_c = -2 * sums[G_P_DX], -2 * sums[G_P_DY], -2 * c * sums[G_DY_DY]
    # a^2 ~ yy / det, b = -a xy / yy, c^2 ~ 1 / yy, det = xx yy - xy^2.
    g_a -= g_b * xy / yy
    g_xx = g_a * (-0.5 * a * yy / det)
    g_yy = g_a * 0.5 * a * (1 / yy - xx / det) + g_b * a * xy / (yy * yy) - g_c * 0.5 * c / yy
    g_xy = g_a * a * xy / det - g_b * a / yy
    for k in range(3):
        g_rows[0, k] = 2 * g_xx * rows_x[k] + g_xy * rows_y[k]
        g_rows[1, k] = 2 * g_yy * rows_y[k] + g_xy * rows_x[k]


@inlined
def _quaternion_gradient(q, norm, m):
    """Gradient of the unnormalised quaternion, from that of its rotation's entries ``m`` (9,)."""
    w, x, y, z = q
    gw = 2 * (x * (m[7] - m[5]) + y * (m[2] - m[6]) + z * (m[3] - m[1]))
    gx = 2 * (y * (m[1] + m[3]) + z * (m[2] + m[6]) + w * (m[7] - m[5]) - 2 * x * (m[4] + m[8]))
    gy = 2 * (x * (m[1] + m[3]) + z * (m[5] + m[7]) + w * (m[2] - m[6]) - 2 * y * (m[0] + m[8]))
    gz = 2 * (x * (m[2] + m[6]) + y * (m[5] + m[7]) + w * (m[3] - m[1]) - 2 * z * (m[0] + m[4]))
    along = gw * w + gx * x + gy * y + gz * z
    return (
        (gw - along * w) / norm,
        (gx - along * x) / norm,
        (gy - along * y) / norm,
        (gz - along * z) / norm,
    )


@inlined
def _axes_gradient(i, view, q, norm, sigmas, g_n, g_scales, g_rotations):
    """Scales' and rotation's gradients, from that of ``view @ rotation @ diag(scales)``."""
    rotation = to_matrix(q[0], q[1], q[2], q[3])
    g_matrix = np.empty(9, np.float64)
    for k in range(3):
        sigma = sigmas[i, k]
        g_scale = 0.0
        for world in range(3):
            # Back through the view's rotation, then split between the axis and its length.
            g = view[world] * g_n[0, k] + view[4 + world] * g_n[1, k] + view[8 + world] * g_n[2, k]
            g_scale += g * rotation[3 * world + k]
            g_matrix[3 * world + k] = g * sigma
        g_scales[i, k] = g_scale
    g_q = _quaternion_gradient(q, norm, g_matrix)
    for k in range(4):
        g_rotations[i, k] = g_q[k]


@inlined
def _footprint_gradient(view, q, sigmas, focals_z, slopes, z, rows, g_rows, g_n):
    """Fill ``g_n`` (3, 3), the gradient of ``n = view @ rotation @ diag(scales)``.

    The footprint's rows are ``focal / z (n[axis] - slope n[2])``.

    Returns:
        The gradients of the two slopes, and of z where it divides the focal length.
    """
    rotation = to_matrix(q[0], q[1], q[2], q[3])
    rows_x, rows_y = rows
    g_slope_x, g_slope_y, g_z = 0.0, 0.0, 0.0
    for k in range(3):
        sigma = sigmas[0] if k == 0 else (sigmas[1] if k == 1 else sigmas[2])
        n2 = view[8] * rotation[k] + view[9] * rotation[3 + k] + view[10] * rotation[6 + k]
        g_n[0, k], g_n[1, k] = focals_z[0] * g_rows[0, k], focals_z[1] * g_rows[1, k]
        g_n[2, k] = -slopes[0] * g_n[0, k] - slopes[1] * g_n[1, k]
        g_slope_x -= g_n[0, k] * n2 * sigma
        g_slope_y -= g_n[1, k] * n2 * sigma
        g_z -= (g_rows[0, k] * rows_x[k] + g_rows[1, k] * rows_y[k]) / z
    return g_slope_x, g_slope_y, g_z


@inlined
def _sum_pairs(i, slots, pairs, sums):
    sums[:] = 0.0
    for slot in range(slots[i], slots[i + 1]):
        for k in range(SUMS):
            sums[k] += pairs[slot, k]


@kernel
def unproject(begin, end, means, scales, rotations, opacities, view, lens, height, width,
              status, records, slots, pairs,
              g_means, g_scales, g_rotations, g_opacities, g_colours):  # fmt: skip
    """Fill the gradients, all zero before, of the Gaussians ``begin`` to ``end``.

    The arguments up to ``records`` are those of the projection, ``slots`` and ``pairs`` those of
    ``gradients.unblend``.
    """
    fx, fy = lens[0], lens[1]
    x_low, x_high = axis_limits(fx, lens[2], width)
    y_low, y_high = axis_limits(fy, lens[3], height)
    g_rows, g_n = np.empty((2, 3), np.float64), np.empty((3, 3), np.float64)
    sums = np.empty(SUMS, np.float64)
    for i in range(begin, end):
        if status[i] != VISIBLE:
            continue
        _sum_pairs(i, slots, pairs, sums)
        g_opacities[i] = sums[G] / (opacities[i] * math.log(2.0))
        for k in range(3):
            g_colours[i, k] = sums[RED + k]
        a, b, c = records[i, A], records[i, B], records[i, C]
        x_z, y_z, z = view_centre(i, means, view)
        slope_x, slope_y = clamp(x_z, x_low, x_high), clamp(y_z, y_low, y_high)
        q, norm = unit_quaternion(i, rotations)
        s0, s1, s2 = np.float64(scales[i, 0]), np.float64(scales[i, 1]), np.float64(scales[i, 2])
        rows = footprint(view, q, s0, s1, s2, fx / z, fy / z, slope_x, slope_y)
        _shape_gradient(sums, a, b, c, rows, g_rows)
        g_slope_x, g_slope_y, g_z = _footprint_gradient(
            view, q, (s0, s1, s2), (fx / z, fy / z), (slope_x, slope_y), z, rows, g_rows, g_n
        )
        _axes_gradient(i, view, q, norm, scales, g_n, g_scales, g_rotations)
        # The centre moves freely; the Jacobian's slopes only inside the frame's margin.
        g_x_z = 2 * a * sums[G_P] * fx + (g_slope_x if slope_x == x_z else 0.0)
        g_y_z = 2 * (b * sums[G_P] + c * c * sums[G_DY]) * fy
        g_y_z += g_slope_y if slope_y == y_z else 0.0
        g_z += sums[DEPTH] - (g_x_z * x_z + g_y_z * y_z) / z
        for k in range(3):
            g_means[i, k] = view[k] * g_x_z / z + view[4 + k] * g_y_z / z + view[8 + k] * g_z
