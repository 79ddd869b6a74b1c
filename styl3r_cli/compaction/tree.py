"""A tree over Gaussians that are near to each other and alike: every cut through it is a scene.

Built from the top: a node is halved across the direction in which its members differ most, in
position (in pixels) and colour together, so that edges in the picture become edges between nodes.
"""

# numba infers the types of the kernels.
# mypy: allow-untyped-defs

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.gaussians import FloatArray
from styl3r_cli.splatting.compiler import inlined, kernel

# How many pixels apart two Gaussians must be to differ as much as black and white do. Measured
# (evaluate/compaction_curve): 5 to 20 are within 0.3 dB.
COLOUR_REACH = 10.0
# What a squared pixel of extent costs beside squared colour differences: little, it decides
# between nodes of one colour only, of which the largest is then split first.
EXTENT_COST = 1e-4
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
        errors: (N,) what merging a node costs: squared colour difference times pixels.
    """

    order: NDArray[np.int64]
    starts: NDArray[np.int32]
    ends: NDArray[np.int32]
    parents: NDArray[np.int32]
    leaves: NDArray[np.bool_]
    errors: NDArray[np.float64]


@dataclass(frozen=True)
class Cut:
    """Nodes that hold every Gaussian once.

    Attributes:
        nodes: (K,) indices.
        labels: (G,) which of them each Gaussian is in.
        split: (N,) the nodes above.
    """

    nodes: NDArray[np.int64]
    labels: NDArray[np.int64]
    split: NDArray[np.bool_]


def build_tree(
    means: FloatArray,
    colours: FloatArray,
    weights: NDArray[np.float64],
    pixel_sizes: NDArray[np.float64],
) -> Tree:
    """Build the tree of (G, 3) means and colours.

    Args:
        means: in scene units.
        colours: sRGB.
        weights: (G,) how many pixels show each Gaussian; positive.
        pixel_sizes: (G,) side of a pixel at its depth, scene units.
    """
    count = 2 * len(means) - 1
    starts, ends = np.zeros(count, np.int32), np.zeros(count, np.int32)
    parents, leaves = np.full(count, -1, np.int32), np.zeros(count, np.bool_)
    errors = np.zeros(count)
    features = np.concatenate([means, colours], axis=1, dtype=np.float64)
    order = np.arange(len(means))
    _build(features, weights, pixel_sizes, order, starts, ends, parents, leaves, errors)
    return Tree(order, starts, ends, parents, leaves, errors)


def cut_tree(
    tree: Tree,
    count: int,
    above: Cut | None = None,
    corrections: NDArray[np.float64] | None = None,
) -> Cut:
    """Split the nodes with the largest errors until there are `count`.

    Args:
        tree: to cut.
        count: how many nodes to end with, at most one a Gaussian.
        above: a cut that this one refines.
        corrections: what the errors of the nodes of `above`, and of all below them, are to be
            multiplied by (what was measured over what the tree foretold).
    """
    factors = np.full(len(tree.errors), -1.0)
    forced = np.zeros(len(tree.errors), np.bool_)
    if above is not None:
        forced = above.split
        factors[above.nodes] = 1.0 if corrections is None else corrections
    ranks = np.empty(len(tree.errors))
    _rank(tree.errors, tree.parents, tree.leaves, factors, forced, ranks)
    splits = min(count - 1, len(tree.order) - 1)
    split = np.zeros(len(tree.errors), np.bool_)
    if splits > 0:
        # Equal ranks by index: a parent before its children.
        split[np.argsort(-ranks, kind="stable")[:splits]] = True
    nodes = np.flatnonzero(~split & ((tree.parents < 0) | split[tree.parents]))
    nodes = nodes[np.argsort(tree.starts[nodes])]
    labels = np.empty(len(tree.order), np.int64)
    sizes = (tree.ends - tree.starts)[nodes]
    labels[tree.order] = np.repeat(np.arange(len(nodes)), sizes)
    return Cut(nodes, labels, split)


@kernel
def _rank(errors, parents, leaves, factors, forced, ranks):
    """Errors after correction, none above its parent's; what must be split first, leaves never."""
    factor = np.ones(len(errors))
    for i in range(len(errors)):
        up = parents[i]
        if up >= 0:
            factor[i] = factor[up]
        if factors[i] >= 0:
            factor[i] = factors[i]
        ranks[i] = math.inf if forced[i] else errors[i] * factor[i]
        if up >= 0:
            ranks[i] = min(ranks[i], ranks[up])
        if leaves[i]:
            ranks[i] = -1.0


@kernel
def _build(features, weights, pixel_sizes, order, starts, ends, parents, leaves, errors):
    right = np.empty(len(order), np.int64)
    mean, spread, axis = np.empty(AXES), np.empty((AXES, AXES)), np.empty(AXES)
    ends[0] = len(order)
    used = 1
    for node in range(len(starts)):
        begin, end = starts[node], ends[node]
        if end - begin == 1:
            leaves[node] = True
            continue
        unit = _spread(features, weights, pixel_sizes, order[begin:end], mean, spread)
        extent = spread[0, 0] + spread[1, 1] + spread[2, 2]
        contrast = (spread[3, 3] + spread[4, 4] + spread[5, 5]) / COLOUR_REACH**2
        errors[node] = contrast + EXTENT_COST * extent
        _principal(spread, axis, ITERATIONS if end - begin > 3 else PAIR_ITERATIONS)
        middle = begin + _partition(features, mean, unit, axis, order[begin:end], right)
        if middle in (begin, end):  # all alike
            middle = (begin + end) // 2
        for side in range(2):
            starts[used], ends[used] = (middle, end) if side else (begin, middle)
            parents[used] = node
            used += 1


@inlined
def _spread(features, weights, pixel_sizes, members, mean, spread):
    """Weighted mean and sum of squares of members, in pixels and colours; the pixel's side."""
    total, unit = 0.0, 0.0
    mean[:] = 0
    spread[:] = 0
    for i in members:
        total += weights[i]
        unit += weights[i] * pixel_sizes[i]
        for k in range(AXES):
            mean[k] += weights[i] * features[i, k]
    unit /= total
    for k in range(AXES):
        mean[k] /= total
    apart = np.empty(AXES)
    for i in members:
        for k in range(3):
            apart[k] = (features[i, k] - mean[k]) / unit
            apart[k + 3] = (features[i, k + 3] - mean[k + 3]) * COLOUR_REACH
        for k in range(AXES):
            for m in range(k, AXES):
                spread[k, m] += weights[i] * apart[k] * apart[m]
    for k in range(AXES):
        for m in range(k):
            spread[k, m] = spread[m, k]
    return unit


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
def _partition(features, mean, unit, axis, members, right):
    """Members on the axis's negative side first; returns how many those are."""
    left, others = 0, 0
    for n in range(len(members)):
        i = members[n]
        side = 0.0
        for k in range(3):
            side += axis[k] * (features[i, k] - mean[k]) / unit
            side += axis[k + 3] * (features[i, k + 3] - mean[k + 3]) * COLOUR_REACH
        if side < 0:
            members[left] = i
            left += 1
        else:
            right[others] = i
            others += 1
    members[left : left + others] = right[:others]
    return left
