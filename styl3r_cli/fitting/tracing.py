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
from styl3r_cli.fitting.shares import list_shares
from styl3r_cli.gaussians import FloatArray, Gaussians
from styl3r_cli.splatting.compiler import inlined, kernel
from styl3r_cli.splatting.constants import TILE
from styl3r_cli.splatting.projection import near_plane, project
from styl3r_cli.splatting.tiles import tile_lists
from styl3r_cli.threads import in_threads

# Shares per pixel that memory is set aside for at first (what stays unused costs none); scenes of
# many semi-transparent layers have more, and are traced again with as much as they need. Scenes of
# 2 to 8 photos have 20 to 30.
EXPECTED_SHARES = 64
assert TILE * TILE <= 1 << 8, "a pixel's place in its tile is a byte"


@dataclass(frozen=True)
class Trace:
    """What one camera sees, Gaussian by Gaussian.

    The E shares come in R runs: what one tile of the frame shows of one Gaussian. That takes half
    the memory of two indices a share. A pixel's shares come front to back.

    Attributes:
        gaussians: (R,) int32, index of each run's Gaussian.
        corners: (R,) int32, row-major index of the first pixel of its tile.
        starts: (R + 1,) int64, where its shares begin.
        places: (E,) uint8, which pixel of the tile, row by row.
        shares: (E,) float32 in [SMALLEST_SHARE, 1].
        width: of the frame, pixels.
        picture: (P, 3) float32, the frame on black, all shares counted; not clipped.
        through: (P,) float32, transmittance: how much of what is behind the scene comes through.
        listed: (P,) float32, sum of the pixel's shares in the matrix: a little less than the rest.
        count: how many Gaussians the scene has.
    """

    gaussians: NDArray[np.int32]
    corners: NDArray[np.int32]
    starts: NDArray[np.int64]
    places: NDArray[np.uint8]
    shares: FloatArray
    width: int
    picture: FloatArray
    through: FloatArray
    listed: FloatArray
    count: int

    @property
    def runs(self) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64]]:
        """Gaussians, corners and starts, as the kernels take them."""
        return self.gaussians, self.corners, self.starts

    def seen(self) -> tuple[NDArray[np.float64], FloatArray]:
        """Each Gaussian's shares: their sum (in pixels), and the largest. Both (G,)."""
        total, largest = np.zeros(self.count), np.zeros(self.count, np.float32)
        _sum_up(self.gaussians, self.starts, self.shares, total, largest)
        return total, largest

    def draw(self, colours: FloatArray) -> FloatArray:
        """The matrix times (G, 3) colours: (P, 3)."""
        out = np.zeros((len(self.picture), 3), np.float32)
        _draw(*self.runs, self.places, self.shares, self.width, colours, out)
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
        _gather(*self.runs, self.places, self.shares, self.width, values, out)
        return out


def trace(gaussians: Gaussians, camera: Camera, near: float) -> Trace:
    """Trace a frame; the picture is the renderer's to rounding. One thread; runs beside others.

    Args:
        gaussians: the scene.
        camera: where from.
        near: view z up to which nothing is drawn.
    """
    made = _trace(gaussians, camera, near, EXPECTED_SHARES * camera.width * camera.height)
    if isinstance(made, int):
        made = _trace(gaussians, camera, near, made)
    assert isinstance(made, Trace)
    return made


def look(gaussians: Gaussians, cameras: Sequence[Camera], threads: int | None) -> list[Trace]:
    """Trace every camera's frame, several at a time."""
    near = near_plane(gaussians.means)
    return in_threads(lambda camera: trace(gaussians, camera, near), cameras, threads)


def look_within(
    gaussians: Gaussians, cameras: Sequence[Camera], most: int, threads: int | None
) -> list[Trace] | int:
    """Trace every camera's frame; or, if more than `most` shares make them, say how many do."""
    near = near_plane(gaussians.means)

    def begin(camera: Camera) -> Trace | int:
        return _trace(gaussians, camera, near, EXPECTED_SHARES * camera.width * camera.height)

    begun = in_threads(begin, cameras, threads)
    needed = sum(each if isinstance(each, int) else len(each.shares) for each in begun)
    if needed > most:
        return needed
    left = [camera for camera, each in zip(cameras, begun, strict=True) if isinstance(each, int)]
    rest = iter(look(gaussians, left, threads))
    return [next(rest) if isinstance(each, int) else each for each in begun]


def _trace(gaussians: Gaussians, camera: Camera, near: float, room: int) -> Trace | int:
    """Trace a frame that has at most so many shares; for one with more, how many it has."""
    splats = project(gaussians, camera, near, 1)
    colours = np.maximum(gaussians.colours, np.float32(0))
    width, height = camera.width, camera.height
    size = width * height
    frame = np.zeros((size, 3), np.float32), np.ones(size, np.float32), np.zeros(size, np.float32)
    bands, used = [], 0
    for band in tile_lists(splats, width, height, TILE, 1):
        most = len(band.members)  # runs, at most
        free = min(max(room - used, 0), most * TILE * TILE)
        listed = np.empty(free, np.uint8), np.empty(free, np.float32)
        runs = np.empty(most, np.int32), np.empty(most, np.int32), np.empty(most, np.int64)
        needed, count = list_shares(
            band.first, band.columns, band.starts, band.members, splats.rects, splats.records,
            colours, width, height, *frame, *listed, *runs,
        )  # fmt: skip
        gaussian, corner, ends = (each[:count] for each in runs)
        bands.append((gaussian, corner, ends + used, *(each[:needed] for each in listed)))
        used += needed
    if used > room:
        return int(used)
    members, corners, ends, places, shares = (
        each[0] if len(each) == 1 else np.concatenate(each) for each in zip(*bands, strict=True)
    )
    starts = np.concatenate([np.zeros(1, np.int64), ends])
    picture, through, sums = frame
    return Trace(
        members,
        corners,
        starts,
        places,
        shares,
        width,
        picture,
        np.abs(through),
        sums,
        len(gaussians),
    )


@inlined
def pixel_of(corner, place, width):
    """The row-major index in the frame of a place in a tile.

    Unsigned: numba checks signed ones for being negative, which takes longer than all the rest.
    """
    row, column = np.uintp(place) // np.uintp(TILE), np.uintp(place) % np.uintp(TILE)
    return np.uintp(corner) + row * np.uintp(width) + column


@kernel
def _sum_up(gaussians, starts, shares, total, largest):
    for run in range(len(gaussians)):
        g = gaussians[run]
        for i in range(np.uintp(starts[run]), np.uintp(starts[run + 1])):
            total[g] += shares[i]
            largest[g] = max(largest[g], shares[i])


@kernel
def _draw(gaussians, corners, starts, places, shares, width, colours, out):
    """Add share times colour of the Gaussian to the pixel."""
    for run in range(len(gaussians)):
        g = gaussians[run]
        red, green, blue = colours[g, 0], colours[g, 1], colours[g, 2]
        for i in range(np.uintp(starts[run]), np.uintp(starts[run + 1])):
            p, share = pixel_of(corners[run], places[i], width), shares[i]
            out[p, 0] += share * red
            out[p, 1] += share * green
            out[p, 2] += share * blue


@kernel
def _gather(gaussians, corners, starts, places, shares, width, values, out):
    """Add share times value of the pixel to the Gaussian."""
    for run in range(len(gaussians)):
        g = gaussians[run]
        a, b, c = np.float32(0), np.float32(0), np.float32(0)
        for i in range(np.uintp(starts[run]), np.uintp(starts[run + 1])):
            p, share = pixel_of(corners[run], places[i], width), shares[i]
            a += share * values[p, 0]
            b += share * values[p, 1]
            c += share * values[p, 2]
        out[g, 0] += a
        out[g, 1] += b
        out[g, 2] += c
