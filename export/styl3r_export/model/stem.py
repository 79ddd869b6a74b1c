"""The convolutional stem of `mini`: RAFT-small's feature encoder, a pyramid to 1/8."""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F


class Pyramid(NamedTuple):
    """Feature maps of one batch of pictures at three scales."""

    half: Float[Tensor, "batch 32 height/2 width/2"]
    quarter: Float[Tensor, "batch 64 height/4 width/4"]
    eighth: Float[Tensor, "batch channels height/8 width/8"]


class Bottleneck(nn.Module):
    """1x1, 3x3, 1x1 convolutions with instance norms, and a shortcut (RAFT, appendix)."""

    def __init__(
        self, in_channels: int, channels: int, stride: int, normalised: bool = True
    ) -> None:
        super().__init__()
        self.normalised = normalised
        self.conv1 = nn.Conv2d(in_channels, channels // 4, 1)
        self.conv2 = nn.Conv2d(channels // 4, channels // 4, 3, stride, 1)
        self.conv3 = nn.Conv2d(channels // 4, channels, 1)
        self.downsample = nn.Conv2d(in_channels, channels, 1, stride) if stride > 1 else None

    def forward(self, x: Float[Tensor, "batch c h w"]) -> Tensor:
        """The block's output, half the size where stride is 2."""
        y = F.relu(norm(self.conv1(x), self.normalised))
        y = F.relu(norm(self.conv2(y), self.normalised))
        y = F.relu(norm(self.conv3(y), self.normalised))
        if self.downsample is not None:
            x = norm(self.downsample(x), self.normalised)
        return F.relu(x + y)


def norm(x: Tensor, wanted: bool) -> Tensor:
    """Instance norm, or nothing."""
    return F.instance_norm(x) if wanted else x


class PyramidStem(nn.Module):
    """RAFT-small's encoders (Teed and Deng, ECCV 2020), also giving their inner maps.

    Trained for optical flow, its 1/8 features match between views of real photos from the
    first step on; parameter names are RAFT's, so its weights load as they are.
    """

    CHANNELS = (32, 64, 128)

    def __init__(self, channels: int = 128, normalised: bool = True) -> None:
        super().__init__()
        self.normalised = normalised
        self.conv1 = nn.Conv2d(3, 32, 7, 2, 3)
        self.layer1 = self._layer(32, 32, 1)
        self.layer2 = self._layer(32, 64, 2)
        self.layer3 = self._layer(64, 96, 2)
        self.conv2 = nn.Conv2d(96, channels, 1)

    def _layer(self, in_channels: int, channels: int, stride: int) -> nn.Sequential:
        return nn.Sequential(
            Bottleneck(in_channels, channels, stride, self.normalised),
            Bottleneck(channels, channels, 1, self.normalised),
        )

    def forward(self, images: Float[Tensor, "batch 3 height width"]) -> Pyramid:
        """The pyramid of pictures in [-1, 1]."""
        half = self.layer1(F.relu(norm(self.conv1(images), self.normalised)))
        quarter = self.layer2(half)
        return Pyramid(half, quarter, self.conv2(self.layer3(quarter)))
