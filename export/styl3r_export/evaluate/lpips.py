"""LPIPS v0.1 with AlexNet (Zhang et al., CVPR 2018), from a plain .npz of its weights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from styl3r_export.curriculum.teachers import load_npz

SHIFT = (-0.030, -0.088, -0.188)  # of pictures in [-1, 1] (published)
SCALE = (0.458, 0.448, 0.450)
# Convolutions of torchvision's AlexNet: name, stride, padding, and a maximum before it or not.
LAYERS = ((0, 4, 2, False), (3, 1, 2, True), (6, 1, 1, True), (8, 1, 1, False), (10, 1, 1, False))
EPS = 1e-10  # keeps the direction of a zero feature finite (published)


class Lpips:
    """Perceptual distance of two pictures; 0 for equal ones."""

    def __init__(self, weights: Path) -> None:
        """Read AlexNet's convolutions (`features.N...`) and the linear layers (`linK.weight`).

        Raises:
            FileNotFoundError: there is no such file.
        """
        self.weights = load_npz(weights)
        self.shift, self.scale = (torch.tensor(v).view(1, 3, 1, 1) for v in (SHIFT, SCALE))

    def __call__(self, a: NDArray[np.floating], b: NDArray[np.floating]) -> float:
        """The distance of pictures (H, W, 3) in [0, 1] (clipped to it)."""
        pair = np.stack([a, b]).clip(0, 1).transpose(0, 3, 1, 2).astype(np.float32)
        with torch.inference_mode():
            return float(self.distance(torch.from_numpy(np.ascontiguousarray(pair))))

    def distance(self, pair: Tensor) -> Tensor:
        """The distance of the two pictures of a batch (2, 3, H, W) in [0, 1]."""
        total = torch.zeros(())
        for level, features in enumerate(self.features(pair)):
            unit = features / (features.square().sum(dim=1, keepdim=True).sqrt() + EPS)
            difference = (unit[0] - unit[1]).square().mean(dim=(1, 2))
            total = total + (difference * self.weights[f"lin{level}.weight"]).sum()
        return total

    def features(self, pictures: Tensor) -> list[Tensor]:
        """Five depths of AlexNet."""
        x = (pictures * 2 - 1 - self.shift) / self.scale
        depths = []
        for layer, stride, padding, pooled in LAYERS:
            if pooled:
                x = F.max_pool2d(x, 3, 2)
            weight, bias = (self.weights[f"features.{layer}.{n}"] for n in ("weight", "bias"))
            x = F.relu(F.conv2d(x, weight, bias, stride, padding))
            depths.append(x)
        return depths
