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

from styl3r_cli.splatting.blending import CHECK_EVERY, LANES, power_of_two, still_live
from styl3r_cli.splatting.compiler import EXACT_ENOUGH, inlined, kernel
from styl3r_cli.splatting.constants import (
    ALPHA_MAX,
    LOG2_INVERSE_ALPHA_MIN,
    PIXEL_CENTRE,
    TILE,
    TRANSMITTANCE_MIN,
)
from styl3r_cli.splatting.projection import LOG_OPACITY, A, B, C, U, V, Z

# Sums over a pair's pixels, with t = log2(alpha), (dx, dy) the offset from the splat's centre, p
# as in projection.py and g = dLoss/dt; then the gradients of red, green, blue and depth.
G, G_P, G_P_DX, G_P_DY, G_DY, G_DY_DY, RED, GREEN, BLUE, DEPTH, SUMS = range(11)

# A pixel's planes: transmittance, loss passed so far, loss in total, and the incoming gradients.
PLANES = 8

# Distances between planes in a segment of LANES pixels, and between segments.
_PASSED, _TOTAL, _RED = np.uintp(LANES), np.uintp(2 * LANES), np.uintp(3 * LANES)
_GREEN, _BLUE, _DEPTH = np.uintp(4 * LANES), np.uintp(5 * LANES), np.uintp(6 * LANES)
_ALPHA, _SEGMENT = np.uintp(7 * LANES), np.uintp(PLANES * LANES)
_ACROSS, _SEGMENTS = TILE // LANES, TILE * TILE // LANES

_ZERO, _ONE, _LN2 = np.float32(0), np.float32(1), np.float32(math.log(2.0))
_ALPHA_MAX = np.float32(ALPHA_MAX)
_TRANSMITTANCE_MIN = np.float32(TRANSMITTANCE_MIN)
_CUTOFF = np.float32(-LOG2_INVERSE_ALPHA_MIN)

# Sums over a row's pixels may be reordered into vector lanes: fixed when compiled, so repeatable.
summing = functools.partial(inlined, fastmath=EXACT_ENOUGH | {"reassoc"})


@summing
def _unblend_segment(state, base, p, dx, a, log_alpha, red, green, blue, z):
    """Sums of g, g p, g p dx and the weighted incoming gradients over a segment's pixels."""
    s0, s1, s2 = _ZERO, _ZERO, _ZERO
    s_red, s_green, s_blue, s_depth = _ZERO, _ZERO, _ZERO, _ZERO
    for j in range(LANES):
        i = base + np.uintp(j)
        x = np.float32(j)
        pj = p + a * x
        t = log_alpha - pj * pj
        free = power_of_two(t)
        alpha = free if free < _ALPHA_MAX else _ALPHA_MAX
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


@inlined
def _unblend_splat(state, live, x0, y0, g, rects, records, colours, sums):
    """Fill one pair's ``sums`` (SUMS,)."""
    u, v, a, b, c = records[g, U], records[g, V], records[g, A], records[g, B], records[g, C]
    log_opacity, z = records[g, LOG_OPACITY], np.float32(records[g, Z])
    red, green, blue = colours[g, 0], colours[g, 1], colours[g, 2]
    left, right = max(rects[g, 0] - x0, 0) // LANES, min(rects[g, 2] - x0, TILE - 1) // LANES
    for column in range(left, right + 1):
        dx = x0 + column * LANES + PIXEL_CENTRE - u
        for y in range(max(rects[g, 1], y0), min(rects[g, 3], y0 + TILE - 1) + 1):
            segment = np.uintp((y - y0) * _ACROSS + column)
            if not live[segment]:
                continue
            dy = y + PIXEL_CENTRE - v
            q = c * dy
            s0, s1, s2, s_red, s_green, s_blue, s_depth = _unblend_segment(
                state, segment * _SEGMENT, np.float32(a * dx + b * dy), np.float32(dx),
                np.float32(a), np.float32(log_opacity - q * q), red, green, blue, z,
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


@inlined
def _load_tile(state, live, x0, y0, incoming, total):
    """Set a tile's planes to the start; pixels outside the frame are finished."""
    height, width = total.shape
    state[:] = _ZERO
    live[:] = True
    for k in range(TILE * TILE):
        base = k // LANES * (PLANES * LANES) + k % LANES
        x, y = x0 + k % TILE, y0 + k // TILE
        if x >= width or y >= height:
            state[base] = -_ONE
            continue
        state[base] = _ONE
        state[base + 2 * LANES] = total[y, x]
        for plane in range(5):
            state[base + (3 + plane) * LANES] = incoming[plane, y, x]


@kernel
def unblend(begin, end, first, columns, starts, members, rects, records, colours, incoming, total,
            slots, pairs):  # fmt: skip
    """Fill ``pairs`` (P, SUMS), all zero before, for some tiles of a band.

    Args:
        begin: first of the tiles.
        end: past the last.
        first: the band's first tile.
        columns: tiles in a row of the frame.
        starts: (tiles + 1,) where each tile's list of splats starts.
        members: the lists.
        rects: (G, 4) the pixels around each splat.
        records: (G, COLUMNS) projected splats.
        colours: (G, 3) not negative.
        incoming: (5, H, W) gradients of weighted red, green, blue, depth, and of alpha.
        total: (H, W) sum over a pixel's splats of weight times (incoming . its values).
        slots: (G + 1,) where each splat's pairs start; a tile per pair, row by row.
        pairs: filled.
    """
    state = np.empty(PLANES * TILE * TILE, np.float32)
    live = np.empty(_SEGMENTS, np.bool_)
    for k in range(begin, end):
        column, row = (first + k) % columns, (first + k) // columns
        _load_tile(state, live, column * TILE, row * TILE, incoming, total)
        for n in range(starts[k], starts[k + 1]):
            due = (n - starts[k]) % CHECK_EVERY == CHECK_EVERY - 1
            if due and not still_live(state, live, _SEGMENT, np.uintp(0)):
                break
            g = members[n]
            wide = rects[g, 2] // TILE - rects[g, 0] // TILE + 1
            slot = slots[g] + (row - rects[g, 1] // TILE) * wide + column - rects[g, 0] // TILE
            _unblend_splat(
                state, live, column * TILE, row * TILE, g, rects, records, colours, pairs[slot]
            )
