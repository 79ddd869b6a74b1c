"""Gaussians as viser draws them: covariances instead of axes, and bytes for colours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.formats.glb_nodes import to_matrices
from styl3r_cli.gaussians import FloatArray, Gaussians
from styl3r_cli.viewer.start import View

# viser sends covariances as half floats, which end at 65504: a standard deviation of 255.
LARGEST = 255.0
HALF_ROUNDING = 2.0**-11
# Rounding moves a covariance's eigenvalues by at most HALF_ROUNDING times its trace, which is at
# most three times its largest one. Where the smallest could become negative, the browser would
# leave the splat out: axes are made this much as long as the longest, 1 : 26, at least.
THINNEST = float(np.sqrt(3 * HALF_ROUNDING))
# viser leaves out a splat whose opacity times the determinant of its covariance on the screen
# (px^2, DILATION added to both variances) is below SEEN: all of a sharp scene's would vanish.
SEEN, DILATION = 0.25, 0.3
# So none is smaller than what is kept in a window of so many rows from AWAY times as far as the
# first view: half a pixel of a photo. Only splats fainter than FAINTEST may still vanish there.
ROWS, AWAY, FAINTEST = 480, 2.0, 0.25


@dataclass(frozen=True)
class Splats:
    """What `add_gaussian_splats` takes.

    Attributes:
        centers: (G, 3), in units of `scale`.
        covariances: (G, 3, 3), in its square: most are near 1, where half floats are precise.
        rgbs: (G, 3) sRGB, 0 to 255.
        opacities: (G, 1), 0 to 255.
        scale: what gives scene units, multiplied by it.
    """

    centers: FloatArray
    covariances: FloatArray
    rgbs: NDArray[np.uint8]
    opacities: NDArray[np.uint8]
    scale: float


def least_scales(gaussians: Gaussians, view: View) -> FloatArray:
    """How large (G,) Gaussians must be to be drawn by viser at and around a view."""
    distances = np.linalg.norm(gaussians.means.astype(np.float64) - view.position, axis=1)
    pixels = distances * AWAY * 2 * np.tan(view.fov / 2) / ROWS
    variances = np.sqrt(SEEN / np.clip(gaussians.opacities, FAINTEST, 1)) - DILATION
    return (pixels * np.sqrt(variances)).astype(np.float32)


def to_splats(gaussians: Gaussians, least: FloatArray | None = None) -> Splats:
    """Gaussians in the world frame as splats in the same frame.

    The covariance is R diag(s)^2 R^T (Kerbl et al. 2023, equation 6). Gaussians over 255 times as
    large as usual, which could not be sent, are made that large.

    Args:
        gaussians: the scene.
        least: (G,) standard deviations that no axis goes below, as from `least_scales`.
    """
    scales = gaussians.scales if least is None else np.maximum(gaussians.scales, least[:, None])
    longest = scales.max(axis=1, initial=0.0).astype(np.float64)
    unit = float(np.median(longest[longest > 0])) if (longest > 0).any() else 1.0
    sides = np.minimum(scales.astype(np.float64) / unit, LARGEST)
    sides = np.maximum(sides, THINNEST * sides.max(axis=1, keepdims=True))
    axes = to_matrices(gaussians.rotations) * sides[:, None, :]
    return Splats(
        centers=(gaussians.means.astype(np.float64) / unit).astype(np.float32),
        covariances=(axes @ axes.transpose(0, 2, 1)).astype(np.float32),
        rgbs=_to_bytes(gaussians.colours),
        opacities=_to_bytes(gaussians.opacities[:, None]),
        scale=unit,
    )


def _to_bytes(shares: FloatArray) -> NDArray[np.uint8]:
    """The nearest of 256 steps (viser itself would round down)."""
    return np.rint(shares.clip(0, 1) * 255).astype(np.uint8)
