"""sRGB's transfer function (IEC 61966-2-1): a straight line up to the knee, then a power."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

KNEE, LINEAR_KNEE, SLOPE = 0.04045, 0.0031308, 12.92
OFFSET, EXPONENT = 0.055, 2.4


def to_linear(colours: NDArray[np.floating]) -> NDArray[np.float64]:
    """Linear light of sRGB, both clipped to [0, 1]."""
    srgb = colours.astype(np.float64).clip(0, 1)
    power = ((srgb + OFFSET) / (1 + OFFSET)) ** EXPONENT
    return np.where(srgb <= KNEE, srgb / SLOPE, power)


def from_linear(colours: NDArray[np.floating]) -> NDArray[np.float64]:
    """Colours in sRGB of linear light, both clipped to [0, 1]."""
    linear = colours.astype(np.float64).clip(0, 1)
    power = (1 + OFFSET) * linear ** (1 / EXPONENT) - OFFSET
    return np.where(linear <= LINEAR_KNEE, linear * SLOPE, power)
