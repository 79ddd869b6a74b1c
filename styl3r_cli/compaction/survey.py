"""A scene before it is compacted: what is seen of it, how it looks, and what is alike."""

# numba infers the types of the kernels.
# mypy: allow-untyped-defs

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.poses import centre
from styl3r_cli.compaction.tree import Tree, build_tree
from styl3r_cli.fitting.refit import Target
from styl3r_cli.fitting.shares import SMALLEST_SHARE
from styl3r_cli.fitting.tracing import Trace, look_within, pixel_of
from styl3r_cli.frames import reduced
from styl3r_cli.gaussians import FloatArray, Gaussians
from styl3r_cli.splatting.compiler import kernel
from styl3r_cli.threads import in_threads

# Part of a pixel that every Gaussian counts for, so that a node of hardly seen ones has a mean.
LEAST_WEIGHT = 1e-3
# Shares that all frames together may list: three times as many as 8 photos' 15 witnesses have, and
# as many as 15 frames of 512 pixels. Compacting takes some 25 bytes for each. Fog has more.
MOST_SHARES = 80_000_000
# The power of a frame's side with which the number of its shares grows. Measured: 1.4 to 1.6 for
# scenes of photos, whose splats are at least a pixel wide in small frames, too; 2 for fog.
SHARES_POWER = 1.5


@dataclass(frozen=True)
class Survey:
    """A scene as its witnesses see it, in the colours that it had then.

    Attributes:
        scene: all G Gaussians.
        cameras: the witnesses; with smaller frames than asked for, if those showed too much.
        traces: what each one sees of the scene.
        seen: (S,) indices of the Gaussians that a witness sees.
        gaussians: the S seen ones.
        weights: (S,) how many pixels show each.
        pixel_sizes: (S,) side of a pixel at its depth, of the nearest witness, scene units.
        tree: over the S seen ones; None if there are none.
    """

    scene: Gaussians
    cameras: list[Camera]
    traces: list[Trace]
    seen: NDArray[np.intp]
    gaussians: Gaussians
    weights: NDArray[np.float64]
    pixel_sizes: NDArray[np.float64]
    tree: Tree | None

    def targets(self, colours: FloatArray) -> list[Target]:
        """How each witness's frame looks, with all Gaussians in these (G, 3) colours."""
        if colours is self.scene.colours:
            return [Target.of(each) for each in self.traces]
        change = colours - self.scene.colours
        return [Target.of(each.recoloured(change)) for each in self.traces]


def survey(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    threads: int | None = None,
    traced: Sequence[tuple[Camera, Trace]] = (),
) -> Survey:
    """Look at a scene from every witness, and sort what is seen into a tree.

    What is seen is whatever can be drawn (finite, an opacity that 8 bits can show) and has a pixel
    that shows some of it.

    Args:
        gaussians: the scene.
        cameras: at least one.
        threads: None for every core.
        traced: what some of the cameras see of these very Gaussians, if that is known.
    """
    cameras, traces = _look(gaussians, cameras, threads, traced)
    weights, largest = np.zeros(len(gaussians)), np.zeros(len(gaussians), np.float32)
    for total, most in in_threads(Trace.seen, traces, threads):
        weights += total
        np.maximum(largest, most, out=largest)
    seen = np.flatnonzero(largest >= SMALLEST_SHARE)
    shown = gaussians.select(seen)
    weights = weights[seen] + LEAST_WEIGHT
    sizes = pixel_sizes(shown, cameras)
    eye = np.mean([centre(camera.extrinsics) for camera in cameras], axis=0)
    tree = None
    if len(seen):
        contrasts = _contrasts(gaussians.colours, traces, threads)[seen]
        tree = build_tree(shown.means, shown.colours, weights, sizes, eye, contrasts, threads)
    return Survey(gaussians, cameras, traces, seen, shown, weights, sizes, tree)


def pixel_sizes(gaussians: Gaussians, cameras: Sequence[Camera]) -> NDArray[np.float64]:
    """(G,) side of a pixel at each Gaussian's depth, from the camera that shows it largest."""
    sizes = np.full(len(gaussians), np.inf)
    for camera in cameras:
        depths = gaussians.means @ camera.extrinsics[2, :3] + camera.extrinsics[2, 3]
        behind = depths <= 0
        np.minimum(sizes, np.where(behind, np.inf, depths / camera.fx), out=sizes)
    return sizes


def _contrasts(
    colours: FloatArray, traces: Sequence[Trace], threads: int | None
) -> NDArray[np.float64]:
    """(G,) squared differences of each Gaussian to the pixels that show it, times its shares."""

    def contrast(each: Trace) -> NDArray[np.float64]:
        found = np.zeros(len(colours))
        _differ(*each.runs, each.places, each.shares, each.width, each.picture, colours, found)
        return found

    return np.sum(in_threads(contrast, traces, threads), axis=0)


@kernel
def _differ(gaussians, corners, starts, places, shares, width, picture, colours, found):
    for run in range(len(gaussians)):
        g = gaussians[run]
        for i in range(starts[run], starts[run + 1]):
            p = pixel_of(corners[run], places[i], width)
            a, b = colours[g, 0] - picture[p, 0], colours[g, 1] - picture[p, 1]
            c = colours[g, 2] - picture[p, 2]
            found[g] += shares[i] * (a * a + b * b + c * c)


def _look(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    threads: int | None,
    traced: Sequence[tuple[Camera, Trace]],
) -> tuple[list[Camera], list[Trace]]:
    """What every camera sees; those that have looked already need not do so again.

    What has too much behind each pixel is looked at in smaller frames: returns their cameras, too.
    """
    known = [
        next((trace for other, trace in traced if _same(camera, other)), None) for camera in cameras
    ]
    others = [camera for camera, trace in zip(cameras, known, strict=True) if trace is None]
    room = MOST_SHARES - sum(len(trace.shares) for trace in known if trace is not None)
    found = look_within(gaussians, others, room, threads)
    if not isinstance(found, int):
        rest = iter(found)
        return list(cameras), [trace or next(rest) for trace in known]
    return _look_smaller(gaussians, cameras, threads, found + MOST_SHARES - room)


def _look_smaller(
    gaussians: Gaussians, cameras: Sequence[Camera], threads: int | None, listed: int
) -> tuple[list[Camera], list[Trace]]:
    """Look through smaller frames than those that listed so many shares: as few as may be."""
    side = max(max(camera.width, camera.height) for camera in cameras)
    while True:
        side = min(int(side * (MOST_SHARES / listed) ** (1 / SHARES_POWER)), side - 1)
        smaller = [reduced(camera, side) for camera in cameras]
        found = look_within(gaussians, smaller, MOST_SHARES, threads)
        if not isinstance(found, int):
            return smaller, found
        listed = found


def _same(a: Camera, b: Camera) -> bool:
    lenses = [(c.fx, c.fy, c.cx, c.cy, c.width, c.height) for c in (a, b)]
    return lenses[0] == lenses[1] and np.array_equal(a.extrinsics, b.extrinsics)
