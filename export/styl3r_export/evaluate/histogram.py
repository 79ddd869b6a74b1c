"""Colour distributions without brightness: HistoGAN's RGB-uv histogram and its distance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Afifi et al., CVPR 2021, section 3.1 and their code: bins, the log-chroma range that they span,
# the kernel's width, and what keeps logarithms finite.
BINS, RANGE = 64, 3.0
FALL_OFF = 0.02
EPS = 1e-6
# Pixels that enter a histogram, at most: every so many-th of larger pictures.
ENOUGH_PIXELS = 1 << 15

Array = NDArray[np.float64]


def histogram(picture: NDArray[np.floating]) -> Array:
    """The RGB-uv histogram (3, BINS, BINS) of a picture (H, W, 3) in [0, 1]; its sum is 1.

    For each colour channel, the logarithms of its ratios to the two others are counted, each pixel
    by its intensity, with an inverse-quadratic kernel (Afifi et al., equations 2 to 4).
    """
    pixels = np.clip(picture.reshape(-1, 3).astype(np.float64), 0, 1)
    pixels = pixels[:: -(-len(pixels) // ENOUGH_PIXELS)]
    intensity = np.linalg.norm(pixels, axis=1)
    logs = np.log(pixels + EPS)
    counts = []
    for channel, (first, second) in enumerate(((1, 2), (0, 2), (0, 1))):
        u = _kernel(logs[:, channel] - logs[:, first])
        v = _kernel(logs[:, channel] - logs[:, second])
        counts.append((u * intensity[:, None]).T @ v)
    total = np.stack(counts)
    return total / (total.sum() + EPS)


def histogram_distance(a: Array, b: Array) -> float:
    """Hellinger distance of two histograms, 0 to 1 (Afifi et al., equation 5)."""
    return float(np.linalg.norm(np.sqrt(a) - np.sqrt(b)) / np.sqrt(2))


def _kernel(values: Array) -> Array:
    """(P, BINS): how much each value counts in each bin."""
    bins = np.linspace(-RANGE, RANGE, BINS)
    return 1 / (1 + ((values[:, None] - bins) / FALL_OFF) ** 2)
