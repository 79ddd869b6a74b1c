"""The renderer's kernels run backwards: from a picture's gradient to the Gaussians'.

The blending walks front to back once more, as when the picture was made, so that the same splats
are skipped and the same pixels stop. What lies behind a splat is the pixel's known total minus
what has been passed. The gradients of a (splat, tile) pair go to a place of their own and are
summed per Gaussian afterwards: no two threads write to one place, and the sums always have the
same order.
"""

# numba infers the types of the kernels.
# mypy: allow-untyped-defs

from __future__ import annotations

import functools
import math

import numpy as np

from styl3r_cli.splatting.blending import (
    CHECK_EVERY,
    covered_lanes,
    covered_rows,
    finished,
    power_of_two,
)
from styl3r_cli.splatting.compiler import EXACT_ENOUGH, kernel
from styl3r_cli.splatting.constants import (
    ALPHA_MAX,
    LOG2_INVERSE_ALPHA_MIN,
    PIXEL_CENTRE,
    TILE,
    TRANSMITTANCE_MIN,
)
from styl3r_cli.splatting.projection import LOG_OPACITY, A, B, C, U, V, Z
from styl3r_cli.splatting.tiles import bin_band

# Sums over a pair's pixels, with t = log2(alpha), (dx, dy) the offset from the splat's centre, p
# as in projection.py and g = dLoss/dt; then the gradients of red, green, blue and depth.
G, G_P, G_P_DX, G_P_DY, G_DY, G_DY_DY, RED, GREEN, BLUE, DEPTH, SUMS = range(11)

# A pixel's planes: transmittance, loss passed so far, loss in total, and the incoming gradients.
PLANES = 8

_AREA = TILE * TILE
_PASSED, _TOTAL, _RED = np.uintp(_AREA), np.uintp(2 * _AREA), np.uintp(3 * _AREA)
_GREEN, _BLUE, _DEPTH = np.uintp(4 * _AREA), np.uintp(5 * _AREA), np.uintp(6 * _AREA)
_ALPHA, _ROW = np.uintp(7 * _AREA), np.uintp(TILE)

_ZERO, _ONE, _LN2 = np.float32(0), np.float32(1), np.float32(math.log(2.0))
_ALPHA_MAX = np.float32(ALPHA_MAX)
_TRANSMITTANCE_MIN = np.float32(TRANSMITTANCE_MIN)
_CUTOFF = np.float32(-LOG2_INVERSE_ALPHA_MIN)

# Sums over a row's pixels may be reordered into vector lanes: fixed when compiled, so repeatable.
summing_kernel = functools.partial(kernel, fastmath=EXACT_ENOUGH | {"reassoc"})


@summing_kernel
def _unblend_row(state, first, past, p, dx, a, log_alpha, red, green, blue, z):
    """Sums of g, g p, g p dx and the weighted incoming gradients over a row of pixels."""
    s0, s1, s2 = _ZERO, _ZERO, _ZERO
    s_red, s_green, s_blue, s_depth = _ZERO, _ZERO, _ZERO, _ZERO
    count = past - first
    for j in range(count):
        i = first + j
        x = np.float32(j)
        pj = p + a * x
        t = log_alpha - pj * pj
        free = power_of_two(t)
        alpha = min(free, _ALPHA_MAX)
        before = state[i]
        hidden = _ONE - alpha
        after = before * hidden
        seen = t >= _CUTOFF
        drawn = seen & (after >= _TRANSMITTANCE_MIN)
        weight = alpha * before if drawn else _ZERO
        loss = (
            red * state[i + _RED] + green * state[i + _GREEN] + blue * state[i + _BLUE]
            + z * state[i + _DEPTH] + state[i + _ALPHA]
        )  # fmt: skip
        passed = state[i + _PASSED] + weight * loss
        state[i + _PASSED] = passed
        state[i] = after if drawn else (-abs(before) if seen else before)
        slope = _LN2 * (weight * loss - alpha * (state[i + _TOTAL] - passed) / hidden)
        g = slope if drawn & (free < _ALPHA_MAX) else _ZERO
        s0 += g
        s1 += g * pj
        s2 += g * pj * (dx + x)
        s_red += weight * state[i + _RED]
        s_green += weight * state[i + _GREEN]
        s_blue += weight * state[i + _BLUE]
        s_depth += weight * state[i + _DEPTH]
    return s0, s1, s2, s_red, s_green, s_blue, s_depth


@kernel
def _unblend_splat(state, x0, y0, g, records, colours, sums):
    """Fill one pair's ``sums`` (SUMS,)."""
    a, b, c = records[g, A], records[g, B], records[g, C]
    log_opacity = records[g, LOG_OPACITY]
    reach = log_opacity + LOG2_INVERSE_ALPHA_MIN
    du = x0 + PIXEL_CENTRE - records[g, U]
    dv = y0 + PIXEL_CENTRE - records[g, V]
    red, green, blue, z = colours[g, 0], colours[g, 1], colours[g, 2], np.float32(records[g, Z])
    first_row, last_row = covered_rows(-dv, c, reach)
    for row in range(first_row, last_row + 1):
        dy = dv + row
        q = c * dy
        rest = reach - q * q
        if rest < 0:
            continue
        p = a * du + b * dy
        low, high = covered_lanes(p, a, rest)
        if low >= high:
            continue
        start = np.uintp(row) * _ROW
        s0, s1, s2, s_red, s_green, s_blue, s_depth = _unblend_row(
            state, start + np.uintp(low), start + np.uintp(high), np.float32(p + a * low),
            np.float32(du + low), np.float32(a), np.float32(log_opacity - q * q),
            red, green, blue, z,
        )  # fmt: skip
        sums[G] += s0
        sums[G_P] += s1
        sums[G_P_DX] += s2
        sums[G_P_DY] += s1 * dy
        sums[G_DY] += s0 * dy
        sums[G_DY_DY] += s0 * dy * dy
        sums[RED] += s_red
        sums[GREEN] += s_green
        sums[BLUE] += s_blue
        sums[DEPTH] += s_depth


@kernel
def _load_tile(state, x0, y0, incoming, total):
    """Set a tile's planes to the start; pixels outside the frame are finished."""
    height, width = total.shape
    state[:] = _ZERO
    state[:_AREA] = -_ONE
    for y in range(y0, min(y0 + TILE, height)):
        for x in range(x0, min(x0 + TILE, width)):
            k = (y - y0) * TILE + x - x0
            state[k] = _ONE
            state[2 * _AREA + k] = total[y, x]
            for plane in range(5):
                state[(3 + plane) * _AREA + k] = incoming[plane, y, x]


@kernel
def unblend(row_begin, row_end, order, order_rects, rects, records, colours, incoming, total,
            slots, pairs):  # fmt: skip
    """Fill ``pairs`` (P, SUMS), all zero before, for the tiles in some rows.

    Args:
        row_begin: first row of tiles.
        row_end: past the last.
        order: (V,) visible splats, nearest first.
        order_rects: (V, 4) their tiles.
        rects: (G, 4) every splat's tiles.
        records: (G, COLUMNS) projected splats.
        colours: (G, 3) not negative.
        incoming: (5, H, W) gradients of weighted red, green, blue, depth, and of alpha.
        total: (H, W) sum over a pixel's splats of weight times (incoming . its values).
        slots: (G + 1,) where each splat's pairs start; a tile per pair, row by row.
        pairs: filled.
    """
    columns = (total.shape[1] + TILE - 1) // TILE
    starts, members = bin_band(row_begin, row_end, columns, order, order_rects)
    state = np.empty(PLANES * _AREA, np.float32)
    for tile in range(len(starts) - 1):
        column, row = tile % columns, row_begin + tile // columns
        _load_tile(state, column * TILE, row * TILE, incoming, total)
        for n in range(starts[tile], starts[tile + 1]):
            if n % CHECK_EVERY == 0 and finished(state[:_AREA]):
                break
            g = members[n]
            wide = rects[g, 2] - rects[g, 0] + 1
            slot = slots[g] + (row - rects[g, 1]) * wide + column - rects[g, 0]
            _unblend_splat(state, column * TILE, row * TILE, g, records, colours, pairs[slot])
