"""Similarities of the world: a turn, a shift and a size at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera

Array = NDArray[np.float64]

# Rounds of reweighted least squares for a view's size and distance; the outliers are the network's
# depths at edges. A residual counts as at least that part of the points' distance, so that no
# point's weight is above all others'.
SIZE_ROUNDS, LEAST_RESIDUAL = 10, 1e-3


def size_of(change: Array) -> float:
    """How much larger a (4, 4) similarity makes things."""
    return float(np.cbrt(np.linalg.det(change[:3, :3])))


def size_and_step(here: Array, there: Array, direction: Array) -> tuple[float, float] | None:
    """The size and the step at which (M, 3) points `there` lie on `here`.

    Minimises the distances of here + step direction to size there, each over how far away it is.

    Args:
        here: one camera's points, turned into the other's axes.
        there: the same places as the other camera has them.
        direction: (3,) of the step, unit.

    Returns:
        None if none or only negative ones do.
    """
    away = np.linalg.norm(here, axis=1)
    good = np.isfinite(there).all(axis=1) & np.isfinite(away) & (here[:, 2] > 0) & (there[:, 2] > 0)
    here, there, away = here[good], there[good], away[good]
    if len(here) < 2:
        return None
    weights, answer = np.ones(len(here)), np.zeros(2)
    matrix = np.stack([there, np.broadcast_to(-direction, there.shape)], axis=-1)
    matrix, wanted = matrix / away[:, None, None], here / away[:, None]
    for _ in range(SIZE_ROUNDS):
        root = np.sqrt(weights)[:, None]
        answer = np.linalg.lstsq(
            (matrix * root[..., None]).reshape(-1, 2), (wanted * root).ravel(), rcond=None
        )[0]
        off = np.linalg.norm(matrix @ answer - wanted, axis=1)
        weights = 1 / np.maximum(off, LEAST_RESIDUAL)
    size, step = (float(value) for value in answer)
    return (size, step) if size > 0 and step > 0 else None


def moved_camera(camera: Camera, change: Array) -> Camera:
    """The camera that sees the world after a similarity as it saw it before."""
    size = size_of(change)
    extrinsics = np.diag([size, size, size, 1.0]) @ camera.extrinsics @ np.linalg.inv(change)
    return replace(camera, extrinsics=extrinsics)
