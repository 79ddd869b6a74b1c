"""A scene with only as many Gaussians as it requires: what came of which, and how it looks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import FloatArray, Gaussians

DROPPED = -1
SQUARED_8BIT_STEP = 1e-12  # errors below (a millionth)^2 count as none: 120 dB


@dataclass(frozen=True)
class Compaction:
    """Which Gaussians became which, and how the result looks.

    Attributes:
        gaussians: the K that are left.
        labels: (G,) which of the K each Gaussian of the scene went into; DROPPED for none.
        cameras: the witnesses.
        decibels: PSNR at each witness against the whole scene, mean over black and white behind.
    """

    gaussians: Gaussians
    labels: NDArray[np.int64]
    cameras: list[Camera]
    decibels: list[float]

    @property
    def worst(self) -> float:
        """PSNR at the witness that differs most."""
        return min(self.decibels)


def everything(scene: Gaussians, cameras: Sequence[Camera]) -> Compaction:
    """The scene as it is."""
    return Compaction(scene, np.arange(len(scene)), list(cameras), [math.inf] * len(cameras))


def decibels(errors: Sequence[FloatArray]) -> list[float]:
    """PSNR of each frame from its squared errors, for a peak of 1."""
    means = [max(float(squared.mean(dtype=np.float64)), SQUARED_8BIT_STEP) for squared in errors]
    return [-10 * math.log10(mean) for mean in means]
