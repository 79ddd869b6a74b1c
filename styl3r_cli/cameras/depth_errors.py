"""How far depths are from true ones: measures of the literature on depth from pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera

# "delta < 1.25" (Eigen et al. 2014): the share of points off by less than this factor.
DELTA = 1.25

Array = NDArray[np.float64]


def view_depths(points: NDArray[np.floating], camera: Camera) -> Array:
    """Depth along the view axis of points (..., 3) in the world frame, in its unit of length.

    What is not finite or behind the camera counts as 0.
    """
    with np.errstate(invalid="ignore"):
        z = points.astype(np.float64) @ camera.extrinsics[2, :3] + camera.extrinsics[2, 3]
    return np.where(np.isfinite(z), z, 0.0).clip(0)


def scale_to(guess: Array, truth: Array) -> float:
    """The factor after which both have the same median (Zhou et al. 2017)."""
    median = float(np.median(guess))
    return float(np.median(truth)) / median if median > 0 else 0.0


def relative_errors(guess: Array, truth: Array) -> tuple[float, float]:
    """AbsRel, and the share of points within a factor of DELTA; true depths are above 0."""
    with np.errstate(divide="ignore"):
        ratio = np.maximum(guess / truth, truth / guess)
    return float(np.mean(np.abs(guess - truth) / truth)), float(np.mean(ratio < DELTA))
