"""How alike two pictures are: PSNR and SSIM."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

# Wang et al. 2004: an 11 x 11 Gaussian window of 1.5 pixels, and the constants that keep flat
# windows from dividing by nothing, for values in [0, 1].
WINDOW, SIGMA = 11, 1.5
C1, C2 = 0.01**2, 0.03**2
LARGEST_PSNR = 100.0  # of equal pictures, so that means stay finite

Values = NDArray[np.floating]


def psnr(a: Values, b: Values) -> float:
    """Peak signal-to-noise ratio in dB of pictures in [0, 1] (clipped to it)."""
    error = float(np.mean((clip(a) - clip(b)) ** 2))
    return LARGEST_PSNR if error == 0 else min(LARGEST_PSNR, -10 * float(np.log10(error)))


def ssim(a: Values, b: Values) -> float:
    """Structural similarity of pictures (H, W, C) in [0, 1], the mean over channels.

    Gaussian windows that lie within the picture, sample covariances: what
    skimage.metrics.structural_similarity gives with win_size=11 and gaussian_weights, which the
    published figures of this family of models are computed with.
    """
    a, b = clip(a), clip(b)
    mean_a, mean_b = _smooth(a), _smooth(b)
    sample = WINDOW**2 / (WINDOW**2 - 1)
    variance_a = sample * (_smooth(a * a) - mean_a**2)
    variance_b = sample * (_smooth(b * b) - mean_b**2)
    covariance = sample * (_smooth(a * b) - mean_a * mean_b)
    above = (2 * mean_a * mean_b + C1) * (2 * covariance + C2)
    below = (mean_a**2 + mean_b**2 + C1) * (variance_a + variance_b + C2)
    edge = WINDOW // 2
    return float((above / below)[edge:-edge, edge:-edge].mean())


def clip(picture: Values) -> NDArray[np.float64]:
    """To [0, 1], in float64."""
    return np.asarray(picture, np.float64).clip(0, 1)


def _smooth(picture: NDArray[np.float64]) -> NDArray[np.float64]:
    blurred = cv2.GaussianBlur(picture, (WINDOW, WINDOW), SIGMA)
    return np.asarray(blurred, np.float64).reshape(picture.shape)  # OpenCV drops a lone channel
