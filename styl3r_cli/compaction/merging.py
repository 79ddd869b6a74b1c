"""Many Gaussians become one: moments are kept, and surfaces stay closed."""

# numba infers the types of the kernels.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.compaction.cuts import Cut
from styl3r_cli.compaction.tree import Tree
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.splatting.compiler import inlined, kernel, parallel_for
from styl3r_cli.splatting.constants import ALPHA_MAX, DILATION
from styl3r_cli.splatting.ewa import to_matrix, unit_quaternion

# How much more the spread of its members' centres counts in a merged Gaussian of two than plain
# moments (0) have it, and how that grows with every doubling of them. With plain moments, those of
# neighbouring blocks of a surface leave gaps: s x s pixels have a variance of (s^2 - 1) / 12 along
# each side, but Gaussians that are s apart close a surface only from about s^2 / 2 on. Two are
# often one surface from two views, with no gap to close. Measured, 0.04 to 0.7 of scenes.
WIDENING, GROWTH = 1.0, 0.3
JACOBI_SWEEPS = 6  # a 3x3 matrix is diagonal to rounding after 4 or 5
# What float32 holds: whatever the unit of length, a merged Gaussian is finite and has a size.
SMALLEST_SCALE = float(np.finfo(np.float32).tiny)
LARGEST_SCALE = float(np.finfo(np.float32).max)


def merge(
    gaussians: Gaussians,
    weights: NDArray[np.float64],
    pixel_sizes: NDArray[np.float64],
    tree: Tree,
    cut: Cut,
    threads: int | None = None,
    widening: float = WIDENING,
) -> Gaussians:
    """One Gaussian per node of a cut, in the nodes' order.

    Means, colours and covariances are the members' moments, weighted; the spread of the members'
    centres counts for more than it is, by `widening`. The opacity keeps opacity times area, as a
    pixel sees both. A node of one member is that member, unchanged.

    Args:
        gaussians: G of them.
        weights: (G,) positive: how many pixels show each.
        pixel_sizes: (G,) side of a pixel at its depth, scene units.
        tree: over the Gaussians.
        cut: through the tree.
        threads: None for every core.
        widening: see WIDENING.
    """
    count = len(cut.nodes)
    merged = Gaussians(
        np.empty((count, 3), np.float32),
        np.empty((count, 3), np.float32),
        np.empty((count, 4), np.float32),
        np.empty(count, np.float32),
        np.empty((count, 3), np.float32),
    )
    parallel_for(
        _merge, count, threads,
        tree.order, tree.starts[cut.nodes], tree.ends[cut.nodes], weights, pixel_sizes,
        float(widening), gaussians.means, gaussians.scales, gaussians.rotations,
        gaussians.opacities, gaussians.colours, merged.means, merged.scales,
        merged.rotations, merged.opacities, merged.colours,
    )  # fmt: skip
    return merged


@kernel
def _merge(begin, end, order, starts, ends, weights, pixel_sizes, widening, means, scales,
           rotations, opacities, colours, new_means, new_scales, new_rotations, new_opacities,
           new_colours):  # fmt: skip
    mean, colour, deviations = np.empty(3), np.empty(3), np.empty(3)
    moments, axes = np.empty((3, 3)), np.empty((3, 3))
    for k in range(begin, end):
        members = order[starts[k] : ends[k]]
        if len(members) == 1:
            i = members[0]
            new_means[k], new_scales[k], new_rotations[k] = means[i], scales[i], rotations[i]
            new_opacities[k], new_colours[k] = opacities[i], colours[i]
            continue
        pixel = _means(members, weights, pixel_sizes, means, colours, mean, colour)
        wider = 1 + widening * (1 + GROWTH * math.log2(len(members) / 2))
        area = _moments(members, weights, pixel_sizes, means, scales, rotations, opacities, mean,
                        wider, moments)  # fmt: skip
        diagonalise(moments, axes)
        for a in range(3):
            new_means[k, a], new_colours[k, a] = mean[a], colour[a]
            deviation = math.sqrt(max(moments[a, a], 0.0))
            deviations[a] = min(max(deviation, SMALLEST_SCALE), LARGEST_SCALE)
            new_scales[k, a] = deviations[a]
        sides = _face(deviations[0], deviations[1], deviations[2], pixel)
        new_opacities[k] = min(area / sides, ALPHA_MAX)
        w, x, y, z = quaternion(axes)
        new_rotations[k, 0], new_rotations[k, 1] = w, x
        new_rotations[k, 2], new_rotations[k, 3] = y, z


@inlined
def _means(members, weights, pixel_sizes, means, colours, mean, colour):
    """Weighted means of positions, colours and (returned) pixel sizes."""
    total, pixel = 0.0, 0.0
    mean[:] = 0
    colour[:] = 0
    for i in members:
        total += weights[i]
        pixel += weights[i] * pixel_sizes[i]
        for a in range(3):
            mean[a] += weights[i] * means[i, a]
            colour[a] += weights[i] * colours[i, a]
    for a in range(3):
        mean[a] /= total
        colour[a] /= total
    return pixel / total


@inlined
def _moments(members, weights, pixel_sizes, means, scales, rotations, opacities, mean,
             widening, moments):  # fmt: skip
    """Fill in the weighted covariance; returns the sum of opacity times area."""
    total, area = 0.0, 0.0
    moments[:] = 0
    for i in members:
        total += weights[i]
        s0 = np.float64(scales[i, 0])  # in float32, squares overflow from 1e19 on
        s1, s2 = np.float64(scales[i, 1]), np.float64(scales[i, 2])
        area += opacities[i] * _face(s0, s1, s2, pixel_sizes[i])
        (qw, qx, qy, qz), _ = unit_quaternion(i, rotations)
        r = to_matrix(qw, qx, qy, qz)
        for a in range(3):
            for b in range(3):
                own = (
                    r[3 * a] * r[3 * b] * s0 * s0
                    + r[3 * a + 1] * r[3 * b + 1] * s1 * s1
                    + r[3 * a + 2] * r[3 * b + 2] * s2 * s2
                )
                apart = (means[i, a] - mean[a]) * (means[i, b] - mean[b])
                moments[a, b] += weights[i] * (own + widening * apart)
    for a in range(3):
        for b in range(3):
            moments[a, b] /= total
    return area


@inlined
def _face(s0, s1, s2, pixel):
    """Area (over 2 pi) of the two larger axes, dilated as the renderer does."""
    low = DILATION * pixel * pixel
    a, b, c = s0 * s0 + low, s1 * s1 + low, s2 * s2 + low
    return math.sqrt(a * b * c / min(a, min(b, c)))


@inlined
def diagonalise(matrix, axes):
    """Jacobi's method: the eigenvalues onto the diagonal, eigenvectors into columns of ``axes``.

    The columns stay a rotation (no reflection), as a quaternion needs.
    """
    axes[:] = 0
    for k in range(3):
        axes[k, k] = 1
    for _ in range(JACOBI_SWEEPS):
        for p in range(2):
            for q in range(p + 1, 3):
                if matrix[p, q] == 0:
                    continue
                theta = (matrix[q, q] - matrix[p, p]) / (2 * matrix[p, q])
                sign = 1.0 if theta >= 0 else -1.0
                t = sign / (abs(theta) + math.sqrt(theta * theta + 1))
                c = 1 / math.sqrt(t * t + 1)
                s = t * c
                for k in range(3):
                    mp, mq = matrix[k, p], matrix[k, q]
                    matrix[k, p], matrix[k, q] = c * mp - s * mq, s * mp + c * mq
                for k in range(3):
                    mp, mq = matrix[p, k], matrix[q, k]
                    matrix[p, k], matrix[q, k] = c * mp - s * mq, s * mp + c * mq
                    ap, aq = axes[k, p], axes[k, q]
                    axes[k, p], axes[k, q] = c * ap - s * aq, s * ap + c * aq


@inlined
def quaternion(m):
    """The unit quaternion w x y z of a rotation, from its largest part (Shepperd 1978)."""
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    if trace > max(m[0, 0], max(m[1, 1], m[2, 2])):
        r = math.sqrt(1 + trace)
        f = 0.5 / r
        return (
            0.5 * r, (m[2, 1] - m[1, 2]) * f, (m[0, 2] - m[2, 0]) * f, (m[1, 0] - m[0, 1]) * f,
        )  # fmt: skip
    if m[0, 0] >= m[1, 1] and m[0, 0] >= m[2, 2]:
        r = math.sqrt(1 + m[0, 0] - m[1, 1] - m[2, 2])
        f = 0.5 / r
        return (
            (m[2, 1] - m[1, 2]) * f, 0.5 * r, (m[0, 1] + m[1, 0]) * f, (m[0, 2] + m[2, 0]) * f,
        )  # fmt: skip
    if m[1, 1] >= m[2, 2]:
        r = math.sqrt(1 - m[0, 0] + m[1, 1] - m[2, 2])
        f = 0.5 / r
        return (
            (m[0, 2] - m[2, 0]) * f, (m[0, 1] + m[1, 0]) * f, 0.5 * r, (m[1, 2] + m[2, 1]) * f,
        )  # fmt: skip
    r = math.sqrt(1 - m[0, 0] - m[1, 1] + m[2, 2])
    f = 0.5 / r
    return (m[1, 0] - m[0, 1]) * f, (m[0, 2] + m[2, 0]) * f, (m[1, 2] + m[2, 1]) * f, 0.5 * r
