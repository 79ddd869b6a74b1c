"""Depth maps as pictures: one scale for all of them, and colours of even steps."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.gaussians import FloatArray

# Depth colours span all but this share of the pixels at each end, which floaters and sky take.
DEPTH_TAIL = 2.0  # percent
SOLID = 0.5  # where less of the background is hidden there is no depth to show
EMPTY = 40  # grey level of such pixels
# Far is 0 and near is 255 in all of them. The last has no colours: for programs, or to print.
COLOUR_MAPS = ("turbo", "inferno", "viridis", "grey")


@dataclass(frozen=True)
class DepthScale:
    """Which depths the colours run between, as 1 / depth, which is what parallax shows.

    Attributes:
        low: 1 / the farthest depth.
        high: 1 / the nearest depth.
    """

    low: float
    high: float

    @classmethod
    def of(cls, depths: Iterable[FloatArray], solid: Iterable[NDArray[np.bool_]]) -> DepthScale:
        """The scale that takes in all but a few percent of some depth maps.

        Args:
            depths: (H, W) each, in scene units.
            solid: where there is a depth.
        """
        seen = [
            1 / depth[mask & (depth > 0)].astype(np.float64)
            for depth, mask in zip(depths, solid, strict=True)
        ]
        nearness = np.concatenate(seen) if seen else np.empty(0)
        if not nearness.size:
            return cls(0.0, 1.0)
        low, high = np.percentile(nearness, [DEPTH_TAIL, 100 - DEPTH_TAIL])
        return cls(float(low), float(high))

    def picture(
        self, depth: FloatArray, solid: NDArray[np.bool_], colour_map: str = COLOUR_MAPS[0]
    ) -> NDArray[np.uint8]:
        """(H, W, 3) sRGB, dark grey where nothing is.

        Args:
            depth: (H, W), in scene units.
            solid: (H, W), where there is a depth.
            colour_map: one of COLOUR_MAPS.
        """
        import cv2

        far = np.zeros(depth.shape)  # float64: in a tiny unit of length 1 / depth is large
        nearness = np.divide(1, depth, out=far, where=solid & (depth > 0), dtype=np.float64)
        span = (self.high - self.low) or self.high or 1.0  # of one depth, all is far
        levels = np.rint(np.clip((nearness - self.low) / span, 0, 1) * 255).astype(np.uint8)
        if colour_map == "grey":
            picture = np.repeat(levels[..., None], 3, axis=2)
        else:
            table = getattr(cv2, f"COLORMAP_{colour_map.upper()}")
            picture = np.array(cv2.applyColorMap(levels, table)[..., ::-1], np.uint8)
        picture[~solid] = EMPTY
        return picture


def colour_depths(
    depths: Sequence[FloatArray], solid: Sequence[NDArray[np.bool_]]
) -> list[NDArray[np.uint8]]:
    """Depth maps in turbo's colours, red near and blue far, on one scale for all of them.

    Args:
        depths: (H, W) each, in scene units.
        solid: where there is a depth; elsewhere the picture is dark grey.
    """
    scale = DepthScale.of(depths, solid)
    return [scale.picture(depth, mask) for depth, mask in zip(depths, solid, strict=True)]
