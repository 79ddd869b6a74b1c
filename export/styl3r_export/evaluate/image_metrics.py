"""How alike two pictures are: PSNR, SSIM, and SSIM of their edges."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_cli.picture_metrics import clip, psnr, ssim

__all__ = ["clip", "edge_ssim", "edges", "psnr", "ssim"]

LUMA = np.array([0.299, 0.587, 0.114])  # ITU-R BT.601
# Largest gradient magnitude that Sobel's filter (divided by 8) gives for values in [0, 1].
SOBEL_SUM, LARGEST_GRADIENT = 8.0, 0.5 * 2**0.5

Picture = NDArray[np.floating]


def edge_ssim(a: Picture, b: Picture) -> float:
    """SSIM of the pictures' luminance edges (Sobel magnitudes): shape without colour."""
    return ssim(edges(a), edges(b))


def edges(picture: Picture) -> NDArray[np.float64]:
    """(H, W, 1): gradient magnitude of the luminance, in [0, 1]."""
    luminance = clip(picture) @ LUMA
    x, y = (cv2.Sobel(luminance, cv2.CV_64F, *d) / SOBEL_SUM for d in ((1, 0), (0, 1)))
    return np.sqrt(x * x + y * y)[..., None] / LARGEST_GRADIENT
