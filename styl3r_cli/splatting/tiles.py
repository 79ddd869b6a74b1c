"""Which splats each tile of the frame draws, nearest first."""

# numba infers the types of the kernels.
# mypy: allow-untyped-defs

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.splatting.compiler import kernel, merged, parallel_for, part_count
from styl3r_cli.splatting.constants import LOG2_CULL_MIN, PIXEL_CENTRE
from styl3r_cli.splatting.ewa import clamp
from styl3r_cli.splatting.projection import LOG_OPACITY, VISIBLE, A, B, C, Splats, U, V

# (tile, splat) pairs that are listed at a time: 128 MB with the depths that sort them. Only very
# large splats on very large frames have more, and are drawn in several bands.
PAIR_BUDGET = 16_000_000

# A float32 is sorted digit by digit. Few values per digit, because most tiles hold few splats.
DIGIT_BITS = 8
DIGITS = 32 // DIGIT_BITS
_VALUES = 1 << DIGIT_BITS
_MASK = np.uint32(_VALUES - 1)

# What a tile costs besides its list, in splats: an empty one must still be written.
TILE_COST = 64


@dataclass(frozen=True)
class TileLists:
    """The splats of a band of tiles.

    Attributes:
        tile: side of a tile, pixels.
        columns: tiles in a row of the frame.
        first: the band's first tile (tiles are counted row by row).
        starts: (tiles + 1,) int64, where each tile's list starts.
        members: splat indices, nearest first within each tile, equal depths by index.
    """

    tile: int
    columns: int
    first: int
    starts: NDArray[np.int64]
    members: NDArray[np.int32]

    @property
    def costs(self) -> NDArray[np.int64]:
        """(tiles + 1,) the work up to each tile, for sharing it out."""
        return self.starts + TILE_COST * np.arange(len(self.starts))


def tile_count(length: int, tile: int) -> int:
    """Tiles along a side of that many pixels (the last may be cut off)."""
    return -(-length // tile)


def tile_lists(
    splats: Splats, width: int, height: int, tile: int, threads: int | None
) -> Iterator[TileLists]:
    """The lists of a frame's tiles, one band of whole rows after the other (mostly one in all).

    Counted, then filled: each part of the splats knows where in a tile's list its own ones go.
    """
    columns, rows = tile_count(width, tile), tile_count(height, tile)
    parts = part_count(len(splats.status), threads)
    counts = np.zeros((parts, rows * columns), np.int64)
    # Positive floats sort like their bits read as integers.
    depths = splats.depths.view(np.uint32)
    where = (splats.status, splats.rects, splats.records, depths, columns, tile)
    none, no_keys = np.empty(0, np.int32), np.empty(0, np.uint32)
    parallel_for(_list, parts, threads, parts, *where, 0, rows, counts, none, no_keys, False)
    totals = counts.sum(axis=0)
    for begin, end in _bands(totals.reshape(rows, columns).sum(axis=1)):
        band = slice(begin * columns, end * columns)
        starts = np.concatenate([[0], np.cumsum(totals[band])])
        places = starts[:-1] + np.cumsum(counts[:, band], axis=0) - counts[:, band]
        members, keys = np.empty(starts[-1], np.int32), np.empty(starts[-1], np.uint32)
        parallel_for(_list, parts, threads, parts, *where, begin, end, places, members, keys, True)
        lists = TileLists(tile, columns, band.start, starts, members)
        spare = np.empty_like(members), np.empty_like(keys)
        arrays = (starts, members, keys, *spare)
        parallel_for(
            _sort, len(starts) - 1, threads, *arrays, costs=lists.costs, scratch=_room_to_sort
        )
        yield lists


def _bands(pairs: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
    """Rows of tiles, begin and end, that are listed together: as many as the budget allows."""
    begin, total = 0, 0
    for row, here in enumerate(pairs.tolist()):
        if row > begin and total + here > PAIR_BUDGET:
            yield begin, row
            begin, total = row, 0
        total += here
    yield begin, len(pairs)


@merged
def _reached_columns(i, records, first, last):
    """How far a splat's outline reaches within some rows of pixels, in pixels' indices.

    The outline's right half, x(dy) = (sqrt(reach - (C dy)^2) - B dy) / A, is concave: between two
    heights its largest x is at its bulge, or at the height that is nearest to it; mirrored, so is
    the left one (exact ellipse-tile intersection, as in Speedy-Splat, arXiv 2412.00578).
    """
    a, b, c = records[i, A], records[i, B], records[i, C]
    reach = records[i, LOG_OPACITY] - LOG2_CULL_MIN
    bulge = -b * math.sqrt(reach / (b * b + c * c)) / c
    edge, centre = math.sqrt(reach) / c, PIXEL_CENTRE - records[i, V]
    top, bottom = clamp(first + centre, -edge, edge), clamp(last + centre, -edge, edge)
    right, left = clamp(bulge, top, bottom), clamp(-bulge, top, bottom)
    x1 = (math.sqrt(clamp(reach - c * c * right * right, 0.0, reach)) - b * right) / a
    x0 = (-math.sqrt(clamp(reach - c * c * left * left, 0.0, reach)) - b * left) / a
    centre = records[i, U] - PIXEL_CENTRE
    return centre + x0, centre + x1


@kernel
def _list(part_begin, part_end, parts, status, rects, records, depths, columns, tile, row_begin,
          row_end, places, members, keys, fill):  # fmt: skip
    """Count each part's splats of each tile into ``places`` (parts, tiles), or list them there."""
    count = len(status)
    for part in range(part_begin, part_end):
        free = places[part]
        for i in range(count * part // parts, count * (part + 1) // parts):
            if status[i] != VISIBLE:
                continue
            first_row, last_row = rects[i, 1] // tile, rects[i, 3] // tile
            first, last = rects[i, 0] // tile, rects[i, 2] // tile
            # Where tiles are so few that the outline misses hardly any, they need no closer look.
            exact = (last - first) + (last_row - first_row) > 1
            for row in range(first_row, last_row + 1):
                if row < row_begin or row >= row_end:
                    continue
                low, high = first, last
                if exact:
                    top = row * tile if row > first_row else rects[i, 1]
                    bottom = (row + 1) * tile - 1 if row < last_row else rects[i, 3]
                    x0, x1 = _reached_columns(i, records, top, bottom)
                    left, right = float(rects[i, 0]), float(rects[i, 2])
                    # A needle's outline may be farther away than integers reach.
                    x0 = clamp(x0 if x0 > left else left, left, right + 1)
                    x1 = clamp(x1 if x1 < right else right, left - 1, right)
                    low, high = math.ceil(x0) // tile, math.floor(x1) // tile
                for t in range((row - row_begin) * columns + low,
                               (row - row_begin) * columns + high + 1):  # fmt: skip
                    if fill:
                        members[free[t]], keys[free[t]] = i, depths[i]
                    free[t] += 1


def _room_to_sort() -> tuple[NDArray[np.int64]]:
    """How often each value occurs, digit by digit."""
    return (np.empty(DIGITS * _VALUES, np.int64),)


@merged
def _sort_list(begin, end, keys, members, other_keys, other_members, counts):
    """Sort one list, stably; digits that all keys share are passed over."""
    for i in range(len(counts)):
        counts[np.uintp(i)] = 0
    for i in range(begin, end):
        key = keys[np.uintp(i)]
        for digit in range(DIGITS):
            value = (key >> np.uint32(digit * DIGIT_BITS)) & _MASK
            counts[np.uintp(digit * _VALUES) + value] += 1
    for digit in range(DIGITS):
        shift, first = np.uint32(digit * DIGIT_BITS), np.uintp(digit * _VALUES)
        if counts[first + ((keys[np.uintp(begin)] >> shift) & _MASK)] == end - begin:
            continue
        place = begin
        for value in range(_VALUES):
            here = counts[first + np.uintp(value)]
            counts[first + np.uintp(value)] = place
            place += here
        for i in range(begin, end):
            key = keys[np.uintp(i)]
            at = first + ((key >> shift) & _MASK)
            place = np.uintp(counts[at])
            counts[at] += 1
            other_keys[place], other_members[place] = key, members[np.uintp(i)]
        for i in range(begin, end):
            keys[np.uintp(i)] = other_keys[np.uintp(i)]
            members[np.uintp(i)] = other_members[np.uintp(i)]


@kernel
def _sort(tile_begin, tile_end, starts, members, keys, other_members, other_keys, counts):
    """Sort the lists of some tiles by their keys; the others are of the same size, for use."""
    for tile in range(tile_begin, tile_end):
        if starts[tile + 1] - starts[tile] > 1:
            _sort_list(
                starts[tile], starts[tile + 1], keys, members, other_keys, other_members, counts
            )
