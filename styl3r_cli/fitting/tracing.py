"""Which Gaussians a camera's pixels show, and how much of each: rendering as a sparse matrix.

A frame is linear in the Gaussians' colours: pixel p shows sum_g share(p, g) colour(g), with shares
alpha T of front-to-back blending (Kerbl et al. 2023, equation 3). The shares say what is seen at
all, and turn "which colours look most like that picture" into linear least squares.
"""

# numba infers the types of the kernels.
# mypy: allow-untyped-defs

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import FloatArray, Gaussians
from styl3r_cli.splatting.blending import power_of_two
from styl3r_cli.splatting.compiler import in_threads, kernel
from styl3r_cli.splatting.constants import (
    ALPHA_MAX,
    LOG2_INVERSE_ALPHA_MIN,
    PIXEL_CENTRE,
    TILE,
    TRANSMITTANCE_MIN,
)
from styl3r_cli.splatting.projection import LOG_OPACITY, A, B, C, U, V, near_plane, project
from styl3r_cli.splatting.tiles import tile_lists

# A share that is smaller moves no 8-bit value by a quarter of a step; leaving it out of the matrix
# (never out of the picture) halves its size.
SMALLEST_SHARE = 1e-3
# Shares per pixel that memory is set aside for at first (what stays unused costs none); scenes of
# many semi-transparent layers have more, and are traced again with as much as they need. Scenes of
# 2 to 8 photos have 20 to 30.
EXPECTED_SHARES = 64

_ONE = np.float32(1)
_ALPHA_MAX = np.float32(ALPHA_MAX)
_CUTOFF = np.float32(-LOG2_INVERSE_ALPHA_MIN)
_TRANSMITTANCE_MIN = np.float32(TRANSMITTANCE_MIN)
_SMALLEST = np.float32(SMALLEST_SHARE)


@dataclass(frozen=True)
class Trace:
    """What one camera sees, Gaussian by Gaussian.

    Attributes:
        pixels: (E,) int32, row-major index of the pixel of each share.
        gaussians: (E,) int32, index of the Gaussian.
        shares: (E,) float32 in (SMALLEST_SHARE, 1].
        picture: (P, 3) float32, the frame on black, all shares counted; not clipped.
        through: (P,) float32, transmittance: how much of what is behind the scene comes through.
        listed: (P,) float32, sum of the pixel's shares in the matrix: a little less than the rest.
        count: how many Gaussians the scene has.
    """

    pixels: NDArray[np.int32]
    gaussians: NDArray[np.int32]
    shares: FloatArray
    picture: FloatArray
    through: FloatArray
    listed: FloatArray
    count: int

    def seen(self) -> tuple[NDArray[np.float64], FloatArray]:
        """Each Gaussian's shares: their sum (in pixels), and the largest. Both (G,)."""
        total, largest = np.zeros(self.count), np.zeros(self.count, np.float32)
        _sum_up(self.gaussians, self.shares, total, largest)
        return total, largest

    def draw(self, colours: FloatArray) -> FloatArray:
        """The matrix times (G, 3) colours: (P, 3)."""
        out = np.zeros((len(self.picture), 3), np.float32)
        _multiply(self.gaussians, self.pixels, self.shares, colours, out)
        return out

    def recoloured(self, change: FloatArray) -> Trace:
        """The same with (G, 3) added to the colours; what changes is drawn with the matrix.

        Shares that are too small for it change as the others of their pixel do on average.
        """
        nothing = np.zeros_like(self.listed)
        whole = np.divide(1 - self.through, self.listed, out=nothing, where=self.listed > 0)
        return replace(self, picture=self.picture + self.draw(change) * whole[:, None])

    def gather(self, values: FloatArray) -> FloatArray:
        """The transposed matrix times (P, 3) values of pixels: (G, 3)."""
        out = np.zeros((self.count, 3), np.float32)
        _multiply(self.pixels, self.gaussians, self.shares, values, out)
        return out


def trace(gaussians: Gaussians, camera: Camera, near: float) -> Trace:
    """Trace a frame; the picture is the renderer's to rounding. One thread; runs beside others.

    Args:
        gaussians: the scene.
        camera: where from.
        near: view z up to which nothing is drawn.
    """
    splats = project(gaussians, camera, near, 1)
    colours = np.maximum(gaussians.colours, np.float32(0))
    size = camera.width * camera.height
    picture = np.zeros((size, 3), np.float32)
    through, listed = np.ones(size, np.float32), np.zeros(size, np.float32)
    found = []
    for band in tile_lists(splats, camera.width, camera.height, TILE, 1):
        room = min(EXPECTED_SHARES * size, max(1, len(band.members) * TILE * TILE))
        while True:
            entries = (
                np.empty(room, np.int32),
                np.empty(room, np.int32),
                np.empty(room, np.float32),
            )
            needed = _trace(
                band.first, band.columns, band.starts, band.members, splats.rects, splats.records,
                colours, camera.width, camera.height, picture, through, listed, *entries,
            )  # fmt: skip
            if needed <= room:
                break
            room = needed
        found.append([each[:needed] for each in entries])
    pixels, members, shares = (
        each[0] if len(each) == 1 else np.concatenate(each) for each in zip(*found, strict=True)
    )
    return Trace(pixels, members, shares, picture, np.abs(through), listed, len(gaussians))


def look(gaussians: Gaussians, cameras: Sequence[Camera], threads: int | None) -> list[Trace]:
    """Trace every camera's frame, several at a time."""
    near = near_plane(gaussians.means)
    return in_threads(lambda camera: trace(gaussians, camera, near), cameras, threads)


@kernel
def _trace(first, columns, starts, members, rects, records, colours, width, height, picture,
           through, listed, pixels, gaussians, shares):  # fmt: skip
    """Blend a band of tiles and list its shares; returns how many there are, even beyond room."""
    used = 0
    for k in range(len(starts) - 1):
        x0, y0 = (first + k) % columns * TILE, (first + k) // columns * TILE
        for y in range(y0, min(y0 + TILE, height)):  # a second attempt starts afresh
            for x in range(x0, min(x0 + TILE, width)):
                through[y * width + x] = _ONE
                picture[y * width + x] = 0
                listed[y * width + x] = 0
        for n in range(starts[k], starts[k + 1]):
            g = members[n]
            a, b = np.float32(records[g, A]), records[g, B]
            log_opacity = records[g, LOG_OPACITY]
            left, right = max(rects[g, 0], x0), min(rects[g, 2], x0 + TILE - 1)
            for y in range(max(rects[g, 1], y0), min(rects[g, 3], y0 + TILE - 1) + 1):
                dy = y + PIXEL_CENTRE - records[g, V]
                q = records[g, C] * dy
                row = np.float32(log_opacity - q * q)
                if row < _CUTOFF:
                    continue
                p0 = np.float32(records[g, A] * (left + PIXEL_CENTRE - records[g, U]) + b * dy)
                for x in range(left, right + 1):
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
                        continue
                    through[pixel] = after
                    share = alpha * before
                    for channel in range(3):
                        picture[pixel, channel] += share * colours[g, channel]
                    if share < _SMALLEST:
                        continue
                    listed[pixel] += share
                    if used < len(pixels):
                        pixels[used], gaussians[used], shares[used] = pixel, g, share
                    used += 1
    return used


@kernel
def _sum_up(gaussians, shares, total, largest):
    for i in range(len(gaussians)):
        g = gaussians[i]
        total[g] += shares[i]
        largest[g] = max(largest[g], shares[i])


@kernel
def _multiply(sources, targets, shares, values, out):
    """Add share times values[source] to out[target], three columns at once."""
    for i in range(len(shares)):
        source, target, share = sources[i], targets[i], shares[i]
        out[target, 0] += share * values[source, 0]
        out[target, 1] += share * values[source, 1]
        out[target, 2] += share * values[source, 2]
