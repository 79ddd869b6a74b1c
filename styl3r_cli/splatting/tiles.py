"""Which splats each tile of the frame draws, nearest first."""

# numba infers the types of the kernels.
# mypy: allow-untyped-defs

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.splatting.compiler import kernel
from styl3r_cli.splatting.constants import TILE
from styl3r_cli.splatting.projection import VISIBLE, Splats, Z

RADIX_BITS = 11  # three passes cover a float32, and a histogram of 2^11 stays in the L1 cache

# (tile, splat) pairs that one band may list, on average: 64 MB. Only very large frames and very
# large splats come near it.
PAIR_BUDGET = 16_000_000


def tile_count(length: int) -> int:
    """Tiles along a side of that many pixels (the last may be cut off)."""
    return -(-length // TILE)


def depth_order(splats: Splats) -> NDArray[np.int32]:
    """Indices of the visible splats by view z (as float32), equal ones by index."""
    visible = np.flatnonzero(splats.status == VISIBLE).astype(np.int32)
    # Positive floats sort like their bits read as integers.
    keys = splats.records[visible, Z].astype(np.float32).view(np.uint32)
    return _radix_sort(keys, visible)


@kernel
def _radix_sort(keys, values):
    """The values in the order of their uint32 keys; stable."""
    count = len(keys)
    buckets = 1 << RADIX_BITS
    mask = np.uint32(buckets - 1)
    other_keys, other_values = np.empty_like(keys), np.empty_like(values)
    for shift in range(0, 32, RADIX_BITS):
        starts = np.zeros(buckets + 1, np.int64)
        for i in range(count):
            starts[((keys[i] >> np.uint32(shift)) & mask) + 1] += 1
        for bucket in range(buckets):
            starts[bucket + 1] += starts[bucket]
        for i in range(count):
            bucket = (keys[i] >> np.uint32(shift)) & mask
            other_keys[starts[bucket]] = keys[i]
            other_values[starts[bucket]] = values[i]
            starts[bucket] += 1
        keys, other_keys = other_keys, keys
        values, other_values = other_values, values
    return values


def min_bands(rects: NDArray[np.int32]) -> int:
    """How many bands to cut the frame into so that the lists of a band stay within PAIR_BUDGET."""
    spans = rects[:, 2:].astype(np.int64) - rects[:, :2] + 1
    return 1 + int((spans[:, 0] * spans[:, 1]).sum()) // PAIR_BUDGET


@kernel
def bin_band(row_begin, row_end, columns, order, rects):
    """Lists of splats for the tiles in rows ``row_begin`` to ``row_end`` (exclusive).

    Every band of tiles builds its own lists, so bands need nothing from each other and the
    memory stays that of the bands at work.

    Args:
        row_begin: first row of tiles.
        row_end: past the last row.
        columns: tiles in a row of the frame.
        order: (V,) the visible splats, nearest first.
        rects: (V, 4) their tiles, in that order (read twice from end to end by every band).

    Returns:
        starts: (tiles + 1,) where each tile's list starts, row by row.
        members: splat indices, nearest first within each tile.
    """
    starts = np.zeros((row_end - row_begin) * columns + 1, np.int64)
    for n in range(len(order)):
        for row in range(max(rects[n, 1], row_begin), min(rects[n, 3] + 1, row_end)):
            for column in range(rects[n, 0], rects[n, 2] + 1):
                starts[(row - row_begin) * columns + column + 1] += 1
    for tile in range(len(starts) - 1):
        starts[tile + 1] += starts[tile]
    members = np.empty(starts[-1], np.int32)
    free = starts.copy()
    for n in range(len(order)):
        for row in range(max(rects[n, 1], row_begin), min(rects[n, 3] + 1, row_end)):
            for column in range(rects[n, 0], rects[n, 2] + 1):
                tile = (row - row_begin) * columns + column
                members[free[tile]] = order[n]
                free[tile] += 1
    return starts, members
