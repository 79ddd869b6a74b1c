"""Front-to-back blending that lists which Gaussian shows how much in which pixel."""

# numba infers the types of the kernels.
# mypy: allow-untyped-defs

from __future__ import annotations

import numpy as np

from styl3r_cli.splatting.blending import power_of_two
from styl3r_cli.splatting.compiler import kernel, merged
from styl3r_cli.splatting.constants import (
    ALPHA_MAX,
    LOG2_INVERSE_ALPHA_MIN,
    PIXEL_CENTRE,
    TILE,
    TRANSMITTANCE_MIN,
)
from styl3r_cli.splatting.projection import LOG_OPACITY, A, B, C, U, V

# A share that is smaller moves no 8-bit value by a quarter of a step; leaving it out of the list
# (never out of the picture) halves its length.
SMALLEST_SHARE = 1e-3

_ONE = np.float32(1)
_ALPHA_MAX = np.float32(ALPHA_MAX)
_CUTOFF = np.float32(-LOG2_INVERSE_ALPHA_MIN)
_TRANSMITTANCE_MIN = np.float32(TRANSMITTANCE_MIN)
_SMALLEST = np.float32(SMALLEST_SHARE)


@merged
def _start_tile(x0, y0, right, bottom, width, picture, through, listed):
    for y in range(y0, bottom):
        for x in range(x0, right):
            pixel = y * width + x
            through[pixel] = _ONE
            listed[pixel] = 0
            for channel in range(3):
                picture[pixel, channel] = 0


@kernel
def list_shares(first, columns, starts, members, rects, records, colours, width, height, picture,
                through, listed, places, shares, gaussians, corners, ends):  # fmt: skip
    """Blend a band of tiles into a frame, and list its shares as `tracing.Trace` has them.

    Returns how many shares there are, even beyond the room for them, and how many runs.
    """
    used, runs = 0, 0
    for k in range(len(starts) - 1):
        x0, y0 = (first + k) % columns * TILE, (first + k) // columns * TILE
        right, bottom = min(x0 + TILE, width), min(y0 + TILE, height)
        _start_tile(x0, y0, right, bottom, width, picture, through, listed)
        unfinished = (right - x0) * (bottom - y0)
        for n in range(starts[k], starts[k + 1]):
            if unfinished == 0:
                break
            g, before_it = members[n], used
            a, b = np.float32(records[g, A]), records[g, B]
            log_opacity = records[g, LOG_OPACITY]
            left, last = max(rects[g, 0], x0), min(rects[g, 2], right - 1)
            for y in range(max(rects[g, 1], y0), min(rects[g, 3], bottom - 1) + 1):
                dy = y + PIXEL_CENTRE - records[g, V]
                q = records[g, C] * dy
                row = np.float32(log_opacity - q * q)
                if row < _CUTOFF:
                    continue
                p0 = np.float32(records[g, A] * (left + PIXEL_CENTRE - records[g, U]) + b * dy)
                for x in range(left, last + 1):
                    pixel = y * width + x
                    before = through[pixel]
                    p = p0 + a * np.float32(x - left)
                    t = row - p * p
                    if before < 0 or t < _CUTOFF:
                        continue
                    alpha = min(power_of_two(t), _ALPHA_MAX)
                    after = before * (_ONE - alpha)
                    if after < _TRANSMITTANCE_MIN:
                        through[pixel] = -before  # finished
                        unfinished -= 1
                        continue
                    through[pixel] = after
                    share = alpha * before
                    for channel in range(3):
                        picture[pixel, channel] += share * colours[g, channel]
                    if share < _SMALLEST:
                        continue
                    listed[pixel] += share
                    if used < len(shares):
                        places[used], shares[used] = (y - y0) * TILE + x - x0, share
                    used += 1
            if used > before_it:
                gaussians[runs], corners[runs], ends[runs] = g, y0 * width + x0, used
                runs += 1
    return used, runs
