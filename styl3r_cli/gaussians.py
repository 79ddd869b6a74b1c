"""The Gaussians of a scene: five arrays of equal length, in linear, activated units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float32]


@dataclass(frozen=True)
class Gaussians:
    """G Gaussians in the world frame (the first view's camera; OpenCV axes).

    Attributes:
        means: (G, 3) centres, in scene units.
        scales: (G, 3) standard deviations along the Gaussian's own axes, linear, scene units.
        rotations: (G, 4) unit quaternions w x y z, own axes to world.
        opacities: (G,) in [0, 1].
        colours: (G, 3) sRGB, nominally in [0, 1].
    """

    means: FloatArray
    scales: FloatArray
    rotations: FloatArray
    opacities: FloatArray
    colours: FloatArray

    def __post_init__(self) -> None:
        count = len(self.means)
        expected = {
            "means": (count, 3),
            "scales": (count, 3),
            "rotations": (count, 4),
            "opacities": (count,),
            "colours": (count, 3),
        }
        for name, shape in expected.items():
            array = np.ascontiguousarray(getattr(self, name), dtype=np.float32)
            if array.shape != shape:
                raise ValueError(f"{name} has shape {array.shape}, expected {shape}")
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.means)

    def select(self, which: NDArray[np.bool_] | NDArray[np.integer]) -> Gaussians:
        """The Gaussians that a boolean mask or an index array names, in that order."""
        return Gaussians(
            self.means[which],
            self.scales[which],
            self.rotations[which],
            self.opacities[which],
            self.colours[which],
        )

    def with_colours(self, colours: FloatArray) -> Gaussians:
        """The same geometry in other colours, (G, 3) sRGB."""
        return Gaussians(self.means, self.scales, self.rotations, self.opacities, colours)
