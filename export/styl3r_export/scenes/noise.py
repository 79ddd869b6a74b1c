"""Smooth tileable noise: pictures for textures, a volume for stains and bumps."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

#: Cells along each axis of the noise volume (tileable; 4 floats each, 4 MiB in all).
VOLUME_CELLS = 64


def spectral(
    rng: np.random.Generator, shape: tuple[int, ...], slope: float, lowest: float = 1.0
) -> NDArray[np.float32]:
    """Tileable Gaussian noise with amplitude 1 / frequency^slope, zero mean, unit deviation.

    Args:
        rng: random source.
        shape: extents of the picture or volume.
        slope: 0 is white; natural pictures are near 1 in two dimensions.
        lowest: frequencies below this many waves per extent are damped.
    """
    waves = np.meshgrid(*(np.fft.fftfreq(n) * n for n in shape), indexing="ij")
    frequency = np.sqrt(sum(w * w for w in waves))
    frequency = np.maximum(frequency, lowest)
    spectrum = np.fft.fftn(rng.standard_normal(shape)) / frequency**slope
    spectrum.flat[0] = 0.0
    field = np.fft.ifftn(spectrum).real
    return (field / max(float(field.std()), 1e-9)).astype(np.float32)


@lru_cache(maxsize=1)
def noise_volume() -> NDArray[np.float32]:
    """(n, n, n, 4) tileable noise and its gradient per cell, the same in every scene."""
    rng = np.random.default_rng(20)
    field = spectral(rng, (VOLUME_CELLS,) * 3, slope=2.0, lowest=3.0)
    gradient = [(np.roll(field, -1, axis) - np.roll(field, 1, axis)) / 2 for axis in range(3)]
    volume = np.stack([field, *gradient], -1)
    volume[..., 1:] /= volume[..., 1:].std()
    return np.ascontiguousarray(volume, dtype=np.float32)
