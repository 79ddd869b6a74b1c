"""Front-to-back blending of a frame's splats, tile by tile.

The inner loop runs over the eight pixels of a segment without branches, in float32, so that LLVM
turns it into vector instructions. A tile's state lives in one flat buffer, segment after segment,
and in a segment plane after plane: with a single array and constant distances LLVM need not fear
that the planes overlap, and with unsigned indices numba need not check for negative ones.

Every number depends on the pixel and the splat alone, never on the tile: the picture is the same
for any size of tiles.
"""

# numba infers the types of the kernels.
# mypy: allow-untyped-defs

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.splatting.compiler import inlined, kernel, merged
from styl3r_cli.splatting.constants import (
    ALPHA_MAX,
    LOG2_INVERSE_ALPHA_MIN,
    MEDIAN_TRANSMITTANCE,
    PIXEL_CENTRE,
    TRANSMITTANCE_MIN,
)
from styl3r_cli.splatting.ewa import clamp
from styl3r_cli.splatting.projection import LOG_OPACITY, A, B, C, U, V, Z

# Red, green, blue, depth (all weighted), transmittance, and median depth.
PLANES = 6
TRANSMITTANCE, MEDIAN_DEPTH = 4, 5

# Pixels of a row that are worked on together. Tiles start at multiples of it.
LANES = 8

# How often a tile looks which of its segments are finished, in splats.
CHECK_EVERY = 16

_ZERO, _ONE = np.float32(0), np.float32(1)
_ALPHA_MAX = np.float32(ALPHA_MAX)
_TRANSMITTANCE_MIN = np.float32(TRANSMITTANCE_MIN)
_HIGHEST = np.finfo(np.float32).max
_MEDIAN = np.float32(MEDIAN_TRANSMITTANCE)
_CUTOFF = np.float32(-LOG2_INVERSE_ALPHA_MIN)

# 2^t for t in [-8, 0], the range between alpha 1/255 and 1, is the eighth power of a polynomial
# in t / 8: no bit tricks, which LLVM would not vectorise. Coefficients: Lawson's iteration for the
# smallest relative error of 2^x on [-1, 0], degree 5; 7.5e-8 there, so below 1e-6 after the power.
_EIGHTH = np.float32(0.125)
_C0, _C1, _C2 = (
    np.float32(9.9999992506e-01),
    np.float32(6.9314225259e-01),
    np.float32(2.4017218925e-01),
)
_C3, _C4, _C5 = (
    np.float32(5.5279722583e-02),
    np.float32(9.1886117328e-03),
    np.float32(9.3878833744e-04),
)

# Distances between planes in a segment, and between segments.
_G, _B, _D = np.uintp(LANES), np.uintp(2 * LANES), np.uintp(3 * LANES)
_T, _M, _SEGMENT = np.uintp(4 * LANES), np.uintp(5 * LANES), np.uintp(PLANES * LANES)


@inlined
def power_of_two(t):
    """2^t in float32, for t in [-8, 0]; elsewhere anything."""
    x = t * _EIGHTH
    p = _C0 + x * (_C1 + x * (_C2 + x * (_C3 + x * (_C4 + x * _C5))))
    p *= p
    p *= p
    return p * p


@merged
def start_tile(state, live, x0, y0, width, height, tile):
    """Empty the planes. Pixels outside the frame are finished (transmittance below 0)."""
    for i in range(len(state)):
        state[np.uintp(i)] = _ZERO
    segment = np.uintp(0)
    for y in range(y0, y0 + tile):
        right = width if y < height else 0
        for x in range(x0, x0 + tile, LANES):
            live[segment] = True
            base = segment * _SEGMENT + _T
            for j in range(LANES):
                state[base + np.uintp(j)] = _ONE if x + j < right else -_ONE
            segment += np.uintp(1)


@merged
def still_live(state, live, segment, plane):
    """Note which segments have unfinished pixels; whether any has.

    Args:
        state: a tile's planes.
        live: a flag per segment, which can only go out.
        segment: size of a segment.
        plane: where in it the transmittance starts.
    """
    some = False
    for index in range(len(live)):
        k = np.uintp(index)
        if live[k]:
            base = k * segment + plane
            unfinished = False
            for j in range(LANES):
                unfinished |= state[base + np.uintp(j)] > _ZERO
            live[k] = unfinished
            some |= unfinished
    return some


@inlined
def _blend_segment(state, base, p, a, log_alpha, red, green, blue, z):
    """Add one splat to the pixels of a segment."""
    for j in range(LANES):
        i = base + np.uintp(j)
        pj = p + a * np.float32(j)
        t = log_alpha - pj * pj
        free = power_of_two(t)
        alpha = free if free < _ALPHA_MAX else _ALPHA_MAX
        before = state[i + _T]
        after = before * (_ONE - alpha)
        seen = t >= _CUTOFF
        # A finished pixel's transmittance is stored negated, so it fails this test for good.
        drawn = seen & (after >= _TRANSMITTANCE_MIN)
        weight = alpha * before if drawn else _ZERO
        state[i] += weight * red
        state[i + _G] += weight * green
        state[i + _B] += weight * blue
        state[i + _D] += weight * z
        state[i + _M] = z if drawn & (before > _MEDIAN) else state[i + _M]
        state[i + _T] = after if drawn else (-abs(before) if seen else before)


@inlined
def _blend_tile(state, live, x0, y0, tile, begin, end, members, rects, records, colours):
    across = tile // LANES
    due = CHECK_EVERY
    for n in range(begin, end):
        due -= 1
        if due == 0:
            due = CHECK_EVERY
            if not still_live(state, live, _SEGMENT, _T):
                return
        g = np.uintp(members[np.uintp(n)])
        u, v, a, b, c = records[g, U], records[g, V], records[g, A], records[g, B], records[g, C]
        log_opacity, z = records[g, LOG_OPACITY], np.float32(records[g, Z])
        red, green = clamp(colours[g, 0], _ZERO, _HIGHEST), clamp(colours[g, 1], _ZERO, _HIGHEST)
        blue = clamp(colours[g, 2], _ZERO, _HIGHEST)
        first, last = clamp(rects[g, 1] - y0, 0, tile), clamp(rects[g, 3] - y0, 0, tile - 1)
        left, right = clamp(rects[g, 0] - x0, 0, tile), clamp(rects[g, 2] - x0, 0, tile - 1)
        for column in range(left // LANES, right // LANES + 1):
            # Offsets in float64: a frame's coordinates are too large for float32.
            p0 = a * (x0 + column * LANES + PIXEL_CENTRE - u)
            for row in range(first, last + 1):
                segment = np.uintp(row * across + column)
                if not live[segment]:
                    continue
                dy = y0 + row + PIXEL_CENTRE - v
                q = c * dy
                _blend_segment(
                    state, segment * _SEGMENT, np.float32(p0 + b * dy), np.float32(a),
                    np.float32(log_opacity - q * q), red, green, blue, z,
                )  # fmt: skip


@merged
def _finish_tile(state, planes, x0, y0, width, height, tile):
    """Write a tile's planes to the frame's."""
    base = np.uintp(0)
    for y in range(y0, clamp(y0 + tile, 0, height)):
        for x in range(x0, x0 + tile, LANES):
            for plane in range(PLANES):
                to = np.uintp((plane * height + y) * width + x)
                for j in range(clamp(width - x, 0, LANES)):
                    # Transmittances of finished pixels are negative; nothing else is.
                    planes[to + np.uintp(j)] = abs(state[base + np.uintp(j)])
                base += np.uintp(LANES)


@kernel
def blend(begin, end, first, columns, tile, starts, members, rects, records, colours, width, height,
          planes, state, live):  # fmt: skip
    """Fill the tiles ``begin`` to ``end`` of a band in ``planes`` (PLANES * H * W,).

    ``state`` and ``live`` are as of `room_for`.
    """
    for k in range(begin, end):
        x0, y0 = (first + k) % columns * tile, (first + k) // columns * tile
        start_tile(state, live, x0, y0, width, height, tile)
        _blend_tile(
            state, live, x0, y0, tile, starts[k], starts[k + 1], members, rects, records, colours
        )
        _finish_tile(state, planes, x0, y0, width, height, tile)


def room_for(tile: int) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """The planes of one tile, and a flag per segment."""
    return np.empty(PLANES * tile * tile, np.float32), np.empty(tile * tile // LANES, np.bool_)
