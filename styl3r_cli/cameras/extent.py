"""Where a scene is, as cameras must know it: robust to floaters, weighted by opacity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras import poses
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import Gaussians

Array = NDArray[np.float64]

# Points that stand for the scene: a path is fitted in a tenth of a second, and a cell of the grid
# below still gets twenty of them.
MOST_POINTS = 20_000
FAINTEST = 0.1  # opacity below which a Gaussian hides nothing and is no obstacle
# Nearest and farthest mean all but a few percent, which are often floaters or sky.
NEAREST, FARTHEST = 0.05, 0.95
LOW, HIGH = 0.02, 0.98  # of the scene along an axis, for its bounds
GRID = 32  # cells along a frame's longer side: holes smaller than one are not seen
OBSTACLE = 0.01  # share of the scene that may be nearer than what a camera keeps its distance from


@dataclass(frozen=True)
class Extent:
    """A sample of the Gaussians that can be seen.

    Attributes:
        means: (P, 3) float64, in scene units.
        weights: (P,) their opacities.
    """

    means: Array
    weights: Array

    @classmethod
    def of(cls, gaussians: Gaussians) -> Extent:
        """Every n-th of the finite Gaussians that are not nearly transparent."""
        kept = np.isfinite(gaussians.means).all(axis=1) & (gaussians.opacities >= FAINTEST)
        chosen = np.flatnonzero(kept)
        chosen = chosen[:: -(-len(chosen) // MOST_POINTS) or 1]
        return cls(
            gaussians.means[chosen].astype(np.float64),
            gaussians.opacities[chosen].astype(np.float64),
        )

    def bounds(self) -> tuple[Array, Array]:
        """(3,) lowest and (3,) highest coordinates of all but a few percent of the scene."""
        sides = [quantiles(axis, self.weights, (LOW, HIGH)) for axis in self.means.T]
        return np.array([low for low, _ in sides]), np.array([high for _, high in sides])

    def depths(self, camera: Camera) -> tuple[float, float, float]:
        """Nearest, median and farthest depth of what a camera has in its frame."""
        depth, inside, _ = self._project(camera)
        chosen = inside if inside.any() else depth > 0
        if not chosen.any():
            return 1.0, 1.0, 1.0
        shares = (NEAREST, 0.5, FARTHEST)
        nearest, middle, farthest = quantiles(depth[chosen], self.weights[chosen], shares)
        return nearest, middle, farthest

    def share_in(self, camera: Camera) -> float:
        """Share of the scene that is in a camera's frame; 0 of an empty one."""
        _, inside, _ = self._project(camera)
        return float(self.weights[inside].sum() / max(self.weights.sum(), FAINTEST))

    def coverage(self, camera: Camera) -> float:
        """Share of the frame behind which there is something, by a coarse grid."""
        _, inside, pixels = self._project(camera)
        cell = max(camera.width, camera.height) / GRID
        columns, rows = (pixels[inside] // cell).astype(np.int64).T
        across, down = (-int(-side // cell) for side in (camera.width, camera.height))
        filled = np.bincount(rows * across + columns, minlength=across * down) > 0
        return float(filled.mean())

    def clearance(self, camera: Camera) -> float:
        """Distance from the camera to the nearest part of the scene, floaters apart."""
        distances = np.linalg.norm(self.means - poses.centre(camera.extrinsics), axis=1)
        if len(distances) == 0:
            return np.inf
        return quantiles(distances, self.weights, (OBSTACLE,))[0]

    def _project(self, camera: Camera) -> tuple[Array, NDArray[np.bool_], Array]:
        """(P,) depths, (P,) whether in the frame, and (P, 2) pixels."""
        in_view = self.means @ camera.extrinsics[:3, :3].T + camera.extrinsics[:3, 3]
        depth = in_view[:, 2]
        size = np.array([camera.width, camera.height], np.float64)
        with np.errstate(all="ignore"):
            pixels = in_view[:, :2] / depth[:, None] * [camera.fx, camera.fy]
        pixels += [camera.cx, camera.cy]
        inside = (depth > 0) & (pixels >= 0).all(axis=1) & (pixels < size).all(axis=1)
        return depth, inside, pixels


def quantiles(values: Array, weights: Array, shares: Sequence[float]) -> list[float]:
    """The values below which lie the given shares of all weight.

    With equal weights, the share 0.5 is the median.
    """
    order = np.argsort(values, kind="stable")
    reached = np.cumsum(weights[order])
    middles = reached - weights[order] / 2
    return [float(np.interp(share * reached[-1], middles, values[order])) for share in shares]
