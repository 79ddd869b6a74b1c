"""A tree over Gaussians that are near to each other and alike: every cut through it is a scene.

Built from the top: a node is halved across the direction in which its members differ most, in
position (in pixels) and colour together, so that edges in the picture become edges between nodes.
Depth counts double, so that what lies behind a surface is not merged into it.
"""

# numba infers the types of the kernels.
# mypy: allow-untyped-defs

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.gaussians import FloatArray
from styl3r_cli.splatting.compiler import inlined, kernel, parallel_for

# How many pixels apart two Gaussians must be to differ as much as black and white do. Measured
# (evaluate/compaction_curve): 5 to 20 are within 0.3 dB.
COLOUR_REACH = 10.0
# How much more a distance along the line of sight counts than one across it: what is merged with
# something behind it covers more than before. Measured: 2 is 1.5 to 2 dB better than 1.
DEPTH_STRETCH = 2.0
# What a squared pixel of extent costs beside squared colour differences: little, it decides
# between nodes of one colour only, of which the largest is then split first.
EXTENT_COST = 1e-4
# What a new shape costs Gaussians that differ from the pixels that show them, beside squared colour
# differences, and the members' mean squared distance, in pixels, at which half of that is due: one
# in the colour of its surroundings may have any shape. Measured on three scenes: worth 2.5 dB at
# half of the Gaussians, as far as the tree alone decides; 0.05 to 0.15 are within 0.1 dB.
SHAPE_COST, SHAPE_REACH = 0.12, 1.0
# Power iterations towards a node's principal direction; any direction near it halves as well.
ITERATIONS = 6
PAIR_ITERATIONS = 2  # of two or three members, whose spread has hardly a second direction

AXES = 6  # position and colour


@dataclass(frozen=True)
class Tree:
    """A binary tree; parents come before their children.

    Attributes:
        order: (G,) the Gaussians, those of a node side by side.
        starts: (N,) where a node's Gaussians start in `order`.
        ends: (N,) where they end.
        parents: (N,) -1 for the root.
        leaves: (N,) whether a node is a single Gaussian.
        errors: (N,) what merging a node costs: squared colour difference times pixels, and shapes.
    """

    order: NDArray[np.int64]
    starts: NDArray[np.int32]
    ends: NDArray[np.int32]
    parents: NDArray[np.int32]
    leaves: NDArray[np.bool_]
    errors: NDArray[np.float64]


def build_tree(
    means: FloatArray,
    colours: FloatArray,
    weights: NDArray[np.float64],
    pixel_sizes: NDArray[np.float64],
    eye: NDArray[np.floating] | None = None,
    contrasts: NDArray[np.float64] | None = None,
    threads: int | None = None,
) -> Tree:
    """Build the tree of (G, 3) means and colours, the same for any number of threads.

    Args:
        means: in scene units.
        colours: sRGB.
        weights: (G,) how many pixels show each Gaussian; positive.
        pixel_sizes: (G,) side of a pixel at its depth, scene units.
        eye: (3,) from where the scene is looked at, about; None if depth is to count no more.
        contrasts: (G,) squared differences of each to the pixels that show it, summed over all
            of these by how much they show; None if shapes are to cost nothing.
        threads: None for every core.
    """
    count = 2 * len(means) - 1
    starts, ends = np.zeros(count, np.int32), np.zeros(count, np.int32)
    parents, errors = np.full(count, -1, np.int32), np.zeros(count)
    features = np.concatenate([means, colours], axis=1, dtype=np.float64)
    order, spare = np.arange(len(means)), np.empty(len(means), np.int64)
    stretch = 1.0 if eye is None else DEPTH_STRETCH
    edges = np.zeros(len(means)) if contrasts is None else contrasts
    look_from = np.zeros(3) if eye is None else np.asarray(eye, np.float64)
    ends[0] = len(order)
    level, below = 0, 1  # a level's nodes have each a place for their children, before any is made
    while level < below:
        sizes = (ends - starts)[level:below]
        children = below + 2 * np.cumsum(sizes > 1) - 2
        parallel_for(
            _split, below - level, threads,
            level, children, features, weights, pixel_sizes, edges, look_from, stretch, order,
            spare, starts, ends, parents, errors, costs=np.concatenate([[0], np.cumsum(sizes)]),
        )  # fmt: skip
        level, below = below, int(children[-1]) + 2
    return Tree(order, starts, ends, parents, ends - starts == 1, errors)


@kernel
def _split(begin, end, level, children, features, weights, pixel_sizes, contrasts, eye, stretch,
           order, spare, starts, ends, parents, errors):  # fmt: skip
    """Halve the nodes from level + begin to level + end that have several members."""
    mean, spread, axis = np.empty(AXES), np.empty((AXES, AXES)), np.empty(AXES)
    apart, sight = np.empty(AXES), np.empty(3)
    for n in range(begin, end):
        node = level + n
        first, last = starts[node], ends[node]
        if last - first == 1:
            continue
        members = order[first:last]
        unit = _means(features, weights, pixel_sizes, members, mean)
        more = _line_of_sight(mean, eye, stretch, sight)
        _spread(features, weights, members, mean, unit, sight, more, apart, spread)
        extent = spread[0, 0] + spread[1, 1] + spread[2, 2]
        contrast = (spread[3, 3] + spread[4, 4] + spread[5, 5]) / COLOUR_REACH**2
        edges = _edges(weights, contrasts, members, extent)
        errors[node] = contrast + SHAPE_COST * edges + EXTENT_COST * extent
        _principal(spread, axis, ITERATIONS if last - first > 3 else PAIR_ITERATIONS)
        _turn_back(axis, unit, sight, more)
        middle = first + _partition(features, mean, axis, members, spare[first:last])
        if middle in (first, last):  # all alike
            middle = (first + last) // 2
        for side in range(2):
            child = children[n] + side
            starts[child], ends[child] = (middle, last) if side else (first, middle)
            parents[child] = node


@inlined
def _means(features, weights, pixel_sizes, members, mean):
    """Weighted means of positions and colours, and (returned) of the pixel's side."""
    total, unit = 0.0, 0.0
    mean[:] = 0
    for i in members:
        total += weights[i]
        unit += weights[i] * pixel_sizes[i]
        for k in range(AXES):
            mean[k] += weights[i] * features[i, k]
    for k in range(AXES):
        mean[k] /= total
    return unit / total


@inlined
def _edges(weights, contrasts, members, extent):
    """The members' contrasts, so far as members that lie that far apart must change in shape."""
    total, edges = 0.0, 0.0
    for i in members:
        total += weights[i]
        edges += contrasts[i]
    return edges * extent / (extent + SHAPE_REACH * total)


@inlined
def _line_of_sight(mean, eye, stretch, sight):
    """The direction from the eye to a place, and how much more than 1 counts along it."""
    length = 0.0
    for k in range(3):
        sight[k] = mean[k] - eye[k]
        length += sight[k] * sight[k]
    length = math.sqrt(length)
    if not 0 < length < math.inf:
        sight[:] = 0
        return 0.0
    for k in range(3):
        sight[k] /= length
    return stretch - 1


@inlined
def _spread(features, weights, members, mean, unit, sight, more, apart, spread):
    """Weighted sum of squares of members, in pixels (more of them in depth) and colours."""
    spread[:] = 0
    for i in members:
        depth = 0.0
        for k in range(3):
            apart[k] = (features[i, k] - mean[k]) / unit
            apart[k + 3] = (features[i, k + 3] - mean[k + 3]) * COLOUR_REACH
            depth += apart[k] * sight[k]
        for k in range(3):
            apart[k] += more * depth * sight[k]
        for k in range(AXES):
            for m in range(k, AXES):
                spread[k, m] += weights[i] * apart[k] * apart[m]
    for k in range(AXES):
        for m in range(k):
            spread[k, m] = spread[m, k]


@inlined
def _turn_back(axis, unit, sight, more):
    """An axis of the spread as one for features: its products with both are the same."""
    depth = 0.0
    for k in range(3):
        depth += axis[k] * sight[k]
    for k in range(3):
        axis[k] = (axis[k] + more * depth * sight[k]) / unit
        axis[k + 3] *= COLOUR_REACH


@inlined
def _principal(spread, axis, iterations):
    """A direction near that of the largest spread, by power iteration."""
    largest = 0
    for k in range(AXES):
        if spread[k, k] > spread[largest, largest]:
            largest = k
    axis[:] = spread[largest]
    product = np.empty(AXES)
    for _ in range(iterations):
        length = 0.0
        for k in range(AXES):
            product[k] = 0.0
            for m in range(AXES):
                product[k] += spread[k, m] * axis[m]
            length = max(length, abs(product[k]))
        if length == 0:
            return
        for k in range(AXES):
            axis[k] = product[k] / length


@inlined
def _partition(features, mean, axis, members, right):
    """Members on the axis's negative side first; returns how many those are."""
    left, others = 0, 0
    for n in range(len(members)):
        i = members[n]
        side = 0.0
        for k in range(AXES):
            side += axis[k] * (features[i, k] - mean[k])
        if side < 0:
            members[left] = i
            left += 1
        else:
            right[others] = i
            others += 1
    members[left : left + others] = right[:others]
    return left
