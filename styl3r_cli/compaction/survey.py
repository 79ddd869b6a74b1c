"""A scene before it is compacted: what is seen of it, how it looks, and what is alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.compaction.tree import Tree, build_tree
from styl3r_cli.fitting.refit import Target
from styl3r_cli.fitting.tracing import SMALLEST_SHARE, look
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.splatting.constants import ALPHA_MIN

# Part of a pixel that every Gaussian counts for, so that a node of hardly seen ones has a mean.
LEAST_WEIGHT = 1e-3


@dataclass(frozen=True)
class Survey:
    """A scene as its witnesses see it.

    Attributes:
        cameras: the witnesses.
        targets: how each one's frame looks, with all Gaussians.
        drawable: (D,) indices of the Gaussians that any camera could see at all.
        seen: (S,) indices of those that a witness sees.
        gaussians: the S seen ones.
        weights: (S,) how many pixels show each.
        pixel_sizes: (S,) side of a pixel at its depth, of the nearest witness, scene units.
        tree: over the S seen ones; None if there are none.
    """

    cameras: list[Camera]
    targets: list[Target]
    drawable: NDArray[np.intp]
    seen: NDArray[np.intp]
    gaussians: Gaussians
    weights: NDArray[np.float64]
    pixel_sizes: NDArray[np.float64]
    tree: Tree | None


def survey(gaussians: Gaussians, cameras: Sequence[Camera], threads: int | None = None) -> Survey:
    """Look at a scene from every witness, and sort what is seen into a tree.

    Args:
        gaussians: the scene.
        cameras: at least one.
        threads: None for every core.
    """
    drawable = np.flatnonzero(can_be_drawn(gaussians))
    scene = gaussians.select(drawable)
    traces = look(scene, cameras, threads)
    weights, largest = np.zeros(len(scene)), np.zeros(len(scene), np.float32)
    for each in traces:
        total, most = each.seen()
        weights += total
        np.maximum(largest, most, out=largest)
    seen = np.flatnonzero(largest >= SMALLEST_SHARE)
    shown = scene.select(seen)
    weights = weights[seen] + LEAST_WEIGHT
    sizes = pixel_sizes(shown, cameras)
    tree = build_tree(shown.means, shown.colours, weights, sizes) if len(seen) else None
    targets = [Target.of(each) for each in traces]
    return Survey(list(cameras), targets, drawable, drawable[seen], shown, weights, sizes, tree)


def can_be_drawn(gaussians: Gaussians) -> NDArray[np.bool_]:
    """(G,) whether any camera could see it: finite, and an opacity that 8 bits can show."""
    drawn = gaussians.opacities >= ALPHA_MIN  # false for NaN
    for array in (gaussians.means, gaussians.scales, gaussians.rotations, gaussians.colours):
        drawn &= np.isfinite(array).all(axis=1)
    return drawn & np.isfinite(gaussians.opacities) & gaussians.rotations.any(axis=1)


def pixel_sizes(gaussians: Gaussians, cameras: Sequence[Camera]) -> NDArray[np.float64]:
    """(G,) side of a pixel at each Gaussian's depth, from the camera that shows it largest."""
    sizes = np.full(len(gaussians), np.inf)
    for camera in cameras:
        depths = gaussians.means @ camera.extrinsics[2, :3] + camera.extrinsics[2, 3]
        behind = depths <= 0
        np.minimum(sizes, np.where(behind, np.inf, depths / camera.fx), out=sizes)
    return sizes
