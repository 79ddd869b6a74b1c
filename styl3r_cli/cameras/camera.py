"""A pinhole camera: extrinsics, intrinsics in pixels, and the frame's size."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Camera:
    """One pinhole camera, OpenCV axes (x right, y down, z forward).

    Pixel coordinates start at the frame's top-left corner: the first pixel's centre is
    (0.5, 0.5), so resizing multiplies fx, fy, cx and cy by one factor.

    Attributes:
        extrinsics: (4, 4) float64, world-to-camera.
        fx: focal length along x, pixels.
        fy: focal length along y, pixels.
        cx: principal point, pixels from the left edge.
        cy: principal point, pixels from the top edge.
        width: frame width, pixels.
        height: frame height, pixels.
    """

    extrinsics: NDArray[np.float64]
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    @property
    def intrinsics(self) -> NDArray[np.float64]:
        """(3, 3) intrinsics in pixels."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], np.float64)

    def resized(self, width: int, height: int) -> Camera:
        """The same view into a frame of another size (each axis scaled on its own)."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=self.cx * sx,
            cy=self.cy * sy,
            width=width,
            height=height,
        )
