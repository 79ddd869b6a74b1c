"""RAFT-small optical flow (Teed and Deng, ECCV 2020), from a plain .npz of its weights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from styl3r_export.curriculum.teachers import load_flow
from styl3r_export.model.flow import LEVELS, Flow
from styl3r_export.model.stem import PyramidStem

# The published network's updates.
ROUNDS = 12
STRIDE = 8  # pixels of one cell
SMALLEST_SIDE = 2 * STRIDE << (LEVELS - 1)  # two cells in the coarsest level


class Raft:
    """Where the pixels of one picture are in another: the authors' weights, not mini's."""

    def __init__(self, weights: Path) -> None:
        """Read the authors' weights, names as in their state dict.

        Raises:
            FileNotFoundError: there is no such file.
        """
        self.stem, self.flow = PyramidStem().eval(), Flow(ROUNDS).eval()
        load_flow(self.stem, self.flow, weights)

    def __call__(self, a: NDArray[np.floating], b: NDArray[np.floating]) -> NDArray[np.float32]:
        """Flow (H, W, 2), x and y in pixels, from picture a to picture b.

        Args:
            a: (H, W, 3) in [0, 1]; sides multiples of 8, at least SMALLEST_SIDE.
            b: of the same shape.
        """
        pair = np.stack([a, b]).clip(0, 1).transpose(0, 3, 1, 2).astype(np.float32)
        coarse = self.coarse_flow(torch.from_numpy(np.ascontiguousarray(pair)) * 2 - 1)
        fine = F.interpolate(
            STRIDE * coarse, scale_factor=STRIDE, mode="bilinear", align_corners=True
        )
        return fine[0].permute(1, 2, 0).numpy()

    @torch.no_grad()
    def coarse_flow(self, pair: Tensor) -> Tensor:
        """Flow (1, 2, H/8, W/8) in cells, of two pictures (2, 3, H, W) in [-1, 1]."""
        if min(pair.shape[-2:]) < SMALLEST_SIDE or any(s % STRIDE for s in pair.shape[-2:]):
            raise ValueError(f"sides must be multiples of {STRIDE}, at least {SMALLEST_SIDE}")
        maps = self.stem(pair).eighth
        return self.flow(maps[:1], maps[1:], self.flow.context(pair[:1])).rounds[-1]
