"""Front-to-back blending of a frame's splats, tile by tile.

The inner loops run over eight pixels of a row without branches, in float32, so that LLVM turns
them into vector instructions. A tile's state lives in one flat buffer of planes: with a single
array and constant distances LLVM need not fear that the planes overlap, and with unsigned
indices numba need not check for negative ones.
"""

# numba infers the types of the kernels.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np

from styl3r_cli.splatting.compiler import kernel
from styl3r_cli.splatting.constants import (
    ALPHA_MAX,
    LOG2_INVERSE_ALPHA_MIN,
    PIXEL_CENTRE,
    TILE,
    TRANSMITTANCE_MIN,
)
from styl3r_cli.splatting.projection import LOG_OPACITY, A, B, C, U, V, Z
from styl3r_cli.splatting.tiles import bin_band

PLANES = 5  # red, green, blue, depth (all weighted), and transmittance

# Pixels that are worked on together; a tile's row is two such halves.
LANES = 8

# How often a tile looks whether all of its pixels are finished, in splats.
CHECK_EVERY = 16

_ZERO, _ONE = np.float32(0), np.float32(1)
_ALPHA_MAX = np.float32(ALPHA_MAX)
_TRANSMITTANCE_MIN = np.float32(TRANSMITTANCE_MIN)
_CUTOFF = np.float32(-LOG2_INVERSE_ALPHA_MIN)

# 2^t for t in [-8, 0], the range between alpha 1/255 and 1, is the eighth power of a polynomial
# in t / 8: no bit tricks, which LLVM would not vectorise. Coefficients: Lawson's iteration for the
# smallest relative error of 2^x on [-1, 0], degree 5; 7.5e-8 there, so below 1e-6 after the power.
_LOWEST = np.float32(-8)
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

_AREA = TILE * TILE
_G, _B, _D, _T = np.uintp(_AREA), np.uintp(2 * _AREA), np.uintp(3 * _AREA), np.uintp(4 * _AREA)
_ROW = np.uintp(TILE)


@kernel
def power_of_two(t):
    """2^t in float32, for t in [-8, 0] (others are clamped)."""
    x = min(max(t, _LOWEST), _ZERO) * _EIGHTH
    p = _C0 + x * (_C1 + x * (_C2 + x * (_C3 + x * (_C4 + x * _C5))))
    p *= p
    p *= p
    return p * p


@kernel
def covered_rows(v, c, reach):
    """First and last row of the tile that a splat reaches; v is relative to the first centre."""
    radius = math.sqrt(reach) / c
    return (
        int(max(np.ceil(v - radius), 0.0)),
        int(min(np.floor(v + radius), TILE - 1.0)),
    )


@kernel
def covered_lanes(p, a, rest):
    """First and past-the-last pixel of a row within reach, widened to whole halves.

    Args:
        p: the splat's p at the row's first pixel.
        a: its growth per pixel.
        rest: how large p^2 may be.
    """
    radius = math.sqrt(rest)
    low, high = (-radius - p) / a, (radius - p) / a
    if high < 0 or low > TILE - 1:
        return 0, 0
    return (0 if low < LANES else LANES), (TILE if high >= LANES else LANES)


@kernel
def start_tile(state, x0, y0, width, height):
    """Empty the planes. Pixels outside the frame are finished (transmittance below 0)."""
    state[:] = _ZERO
    for y in range(TILE):
        for x in range(TILE):
            inside = x0 + x < width and y0 + y < height
            state[4 * _AREA + y * TILE + x] = _ONE if inside else -_ONE


@kernel
def finished(transmittance):
    """Whether every pixel is."""
    for value in transmittance:  # noqa: SIM110 (numba has no `all` of a generator)
        if value > _ZERO:
            return False
    return True


@kernel
def _blend_row(state, first, past, p, a, log_alpha, red, green, blue, z):
    """Add one splat to the pixels ``first`` to ``past`` of ``state``'s planes."""
    count = past - first
    for j in range(count):
        i = first + j
        pj = p + a * np.float32(j)
        t = log_alpha - pj * pj
        alpha = min(power_of_two(t), _ALPHA_MAX)
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
        state[i + _T] = after if drawn else (-abs(before) if seen else before)


@kernel
def _blend_tile(state, x0, y0, members, records, colours):
    for n in range(len(members)):
        if n % CHECK_EVERY == CHECK_EVERY - 1 and finished(state[4 * _AREA :]):
            return
        g = members[n]
        a, b, c = records[g, A], records[g, B], records[g, C]
        log_opacity = records[g, LOG_OPACITY]
        reach = log_opacity + LOG2_INVERSE_ALPHA_MIN
        # Offsets in float64: the rest of a tile's numbers are small, so float32 is exact enough.
        du = x0 + PIXEL_CENTRE - records[g, U]
        dv = y0 + PIXEL_CENTRE - records[g, V]
        red, green = max(colours[g, 0], _ZERO), max(colours[g, 1], _ZERO)
        blue, z = max(colours[g, 2], _ZERO), np.float32(records[g, Z])
        first_row, last_row = covered_rows(-dv, c, reach)
        for row in range(first_row, last_row + 1):
            q = c * (dv + row)
            rest = reach - q * q
            if rest < 0:
                continue
            p = a * du + b * (dv + row)
            low, high = covered_lanes(p, a, rest)
            if low >= high:
                continue
            start = np.uintp(row) * _ROW
            _blend_row(
                state, start + np.uintp(low), start + np.uintp(high), np.float32(p + a * low),
                np.float32(a), np.float32(log_opacity - q * q), red, green, blue, z,
            )  # fmt: skip


@kernel
def blend(row_begin, row_end, order, rects, records, colours, planes):
    """Fill the rows of tiles ``row_begin`` to ``row_end`` of ``planes`` (PLANES, H, W)."""
    height, width = planes.shape[1], planes.shape[2]
    columns = (width + TILE - 1) // TILE
    starts, members = bin_band(row_begin, row_end, columns, order, rects)
    state = np.empty(PLANES * _AREA, np.float32)
    for tile in range(len(starts) - 1):
        x0, y0 = (tile % columns) * TILE, (row_begin + tile // columns) * TILE
        start_tile(state, x0, y0, width, height)
        _blend_tile(state, x0, y0, members[starts[tile] : starts[tile + 1]], records, colours)
        for y in range(y0, min(y0 + TILE, height)):
            for x in range(x0, min(x0 + TILE, width)):
                k = (y - y0) * TILE + x - x0
                for plane in range(PLANES - 1):
                    planes[plane, y, x] = state[plane * _AREA + k]
                planes[PLANES - 1, y, x] = abs(state[(PLANES - 1) * _AREA + k])
