"""Cameras given in the true world, as the model's own world sees them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.poses import centre

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Similarity:
    """True world points x to the model's: scale * rotation @ x + shift."""

    rotation: Array
    scale: float
    shift: Array

    def camera(self, camera: Camera) -> Camera:
        """A true camera, in the model's world."""
        extrinsics = np.eye(4)
        extrinsics[:3, :3] = camera.extrinsics[:3, :3] @ self.rotation.T
        eye = self.scale * self.rotation @ centre(camera.extrinsics) + self.shift
        extrinsics[:3, 3] = -extrinsics[:3, :3] @ eye
        return replace(camera, extrinsics=extrinsics)


def align(true: Sequence[Camera], found: Sequence[Camera]) -> Similarity:
    """What takes the true cameras of the inputs to the model's.

    Nothing but the inputs' cameras is used: the rotation is the mean of the views' own (two
    centres alone would leave a turn about their line open), the scale makes the cameras' spread
    around their middle equal, and the middles coincide.

    Args:
        true: the inputs' true cameras, not all in one place.
        found: their recovered cameras.
    """
    turns = sum(
        f.extrinsics[:3, :3].T @ t.extrinsics[:3, :3] for t, f in zip(true, found, strict=True)
    )
    u, _, vt = np.linalg.svd(turns)
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    true_eyes, found_eyes = (np.array([centre(c.extrinsics) for c in s]) for s in (true, found))
    true_middle, found_middle = true_eyes.mean(axis=0), found_eyes.mean(axis=0)
    spreads = [np.linalg.norm(e - e.mean(axis=0)) for e in (true_eyes, found_eyes)]
    scale = float(spreads[1] / spreads[0])
    return Similarity(rotation, scale, found_middle - scale * rotation @ true_middle)
