"""Colours of `mini`: MicroAST, a style's statistics and modulation on local convolutions."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

# Channels of the two encoders' maps at 1/4 of the picture's size (Wang et al., AAAI 2023).
CHANNELS = 64
# Under the square root of a variance (published).
EPS = 1e-5
# Relative difference of a style's statistics from the first view's at which it counts as a
# picture of its own: crops of one photograph are about 0.1 apart, paintings and photographs
# more than 0.5.
OWN = 0.2
# Keeps the mean of styles defined where every one of them is the scene's own photo.
TINY = 1e-6


class Maps(NamedTuple):
    """An encoder's two maps of a batch of pictures."""

    first: Float[Tensor, "batch 64 h/4 w/4"]
    second: Float[Tensor, "batch 64 h/4 w/4"]


class Code(NamedTuple):
    """What a style does to each of the two maps: rows mean, deviation, weight, bias."""

    first: Float[Tensor, "batch 4 64"]
    second: Float[Tensor, "batch 4 64"]


def convolution(
    inputs: int, outputs: int, side: int, stride: int = 1, groups: int = 1
) -> nn.Conv2d:
    """A convolution over reflected borders."""
    return nn.Conv2d(
        inputs, outputs, side, stride, side // 2, groups=groups, padding_mode="reflect"
    )


class Residual(nn.Module):
    """Two convolutions around the identity, their outputs modulated by a style if there is one."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = convolution(CHANNELS, CHANNELS, 3)
        self.conv2 = convolution(CHANNELS, CHANNELS, 3)

    def forward(
        self,
        x: Float[Tensor, "batch 64 h w"],
        weight: Tensor | float = 1.0,
        bias: Tensor | float = 0.0,
    ) -> Float[Tensor, "batch 64 h w"]:
        """The sum x + w * conv2(h) + b * h, where h = relu(w * conv1(x) + b * x)."""
        h = F.relu(weight * self.conv1(x) + bias * x)
        return x + weight * self.conv2(h) + bias * h


class Encoder(nn.Module):
    """Pictures in [0, 1] to two maps at a quarter of their size."""

    def __init__(self) -> None:
        super().__init__()
        self.enc1 = nn.Sequential(
            convolution(3, 16, 9), nn.ReLU(),
            convolution(16, 32, 3, 2, 16), nn.ReLU(), convolution(32, 32, 1), nn.ReLU(),
            convolution(32, CHANNELS, 3, 2, 32), nn.ReLU(),
            convolution(CHANNELS, CHANNELS, 1), nn.ReLU(),
            Residual(),
        )  # fmt: skip
        self.enc2 = nn.Sequential(Residual())

    def forward(self, pictures: Float[Tensor, "batch 3 h w"]) -> Maps:
        """Both maps."""
        first = self.enc1(pictures)
        return Maps(first, self.enc2(first))


class Modulator(nn.Module):
    """A style's maps to the channels' weights and biases in the decoder."""

    def __init__(self) -> None:
        super().__init__()
        self.weight1, self.bias1, self.weight2, self.bias2 = (
            nn.Sequential(convolution(CHANNELS, CHANNELS, 3, groups=CHANNELS)) for _ in range(4)
        )

    def forward(self, maps: Maps) -> Code:
        """The style's code: its maps' statistics, and their modulation."""

        def code(m: Tensor, weight: nn.Module, bias: nn.Module) -> Tensor:
            mean, deviation = statistics(m[:, None])
            parts = (mean[:, 0, :, 0, 0], deviation[:, 0, :, 0, 0])
            return torch.stack((*parts, weight(m).mean((2, 3)), bias(m).mean((2, 3))), dim=1)

        return Code(
            code(maps.first, self.weight1, self.bias1), code(maps.second, self.weight2, self.bias2)
        )


class Enlarge(nn.Module):
    """Maps of twice the size, and smooth ones if asked for.

    Bilinear interpolation leaves kinks at the samples: frequencies that the finer grid repeats of
    the coarser one. The nonlinearities that follow make a weave of them, and strokes depend on
    where the grid lies. A blur by 1 2 1 leaves a seventh of them and less, and half or more of what
    belongs there, which training sharpens again.
    """

    def __init__(self, smooth: bool) -> None:
        super().__init__()
        self.smooth = smooth

    def forward(self, x: Float[Tensor, "batch c h w"]) -> Float[Tensor, "batch c 2*h 2*w"]:
        """The larger maps."""
        x = F.interpolate(x, scale_factor=2, mode="bilinear")
        if self.smooth:  # 1 2 1 is 1 1 twice
            x = F.avg_pool2d(F.avg_pool2d(F.pad(x, (1, 1, 1, 1), "reflect"), 2, 1), 2, 1)
        return x


class Decoder(nn.Module):
    """Content maps in a style's statistics, back to pictures."""

    def __init__(self, smooth: bool) -> None:
        super().__init__()
        self.dec1 = Residual()
        self.dec2 = Residual()
        self.dec3 = nn.Sequential(
            Enlarge(smooth), convolution(CHANNELS, 32, 3, 1, 32),
            nn.ReLU(), convolution(32, 32, 1), nn.ReLU(),
            Enlarge(smooth), convolution(32, 16, 3, 1, 16),
            nn.ReLU(), convolution(16, 16, 1), nn.ReLU(),
            convolution(16, 3, 9),
        )  # fmt: skip

    def forward(self, content: Maps, code: Code, views: int) -> Float[Tensor, "batch 3 h w"]:
        """Pictures, about [0, 1]; `batch` is scenes times views, codes are one a scene."""
        y = adapt(content.second, code.second, views)
        y = self.dec1(y, *modulation(code.second, views))
        y = adapt(y, code.first, views)
        y = self.dec2(y, *modulation(code.first, views))
        return self.dec3(y)


class Strokes(nn.Module):
    """MicroAST for all views of a scene at once."""

    def __init__(self, smooth: bool = False) -> None:
        super().__init__()
        self.content_encoder = Encoder()
        self.style_encoder = Encoder()
        self.modulator = Modulator()
        self.decoder = Decoder(smooth)

    def forward(
        self,
        images: Float[Tensor, "batch views 3 H W"],
        style_images: Float[Tensor, "batch styles 3 h w"],
        style_weights: Float[Tensor, "batch styles"],
    ) -> Float[Tensor, "batch views 3 H W"]:
        """The views in the weighted style.

        A style picture that is the first view itself asks for the scene's own colours: its share
        of the weights is the photos' share in the result.

        Args:
            images: sRGB in [0, 1].
            style_images: sRGB in [0, 1].
            style_weights: summing to 1 in each scene.
        """
        batch, views = images.shape[:2]
        own = self.modulator(self.style_encoder(images[:, 0]))
        styles = self.modulator(self.style_encoder(style_images.flatten(0, 1)))
        styles = Code(*(c.unflatten(0, style_images.shape[:2]).float() for c in styles))
        foreign = 1 - ownness(styles, Code(*(c.float() for c in own)))
        shares = style_weights * (foreign + TINY)
        code = Code(*(weighted_mean(c, shares) for c in styles))
        content = self.content_encoder(images.flatten(0, 1))
        drawn = self.decoder(content, code, views).float().unflatten(0, (batch, views))
        kept = (style_weights * (1 - foreign)).sum(dim=1)[:, None, None, None, None]
        return drawn + kept * (images - drawn)


def weighted_mean(codes: Float[Tensor, "batch styles 4 64"], shares: Tensor) -> Tensor:
    """One code a scene."""
    return (codes * (shares / shares.sum(dim=1, keepdim=True))[..., None, None]).sum(dim=1)


def ownness(styles: Code, own: Code) -> Float[Tensor, "batch styles"]:
    """1 for a style with the statistics of the scene's own photo, falling to 0 with distance."""
    total = torch.zeros_like(styles.first[..., 0, 0])
    for code, mine in zip(styles, own, strict=True):
        mean, deviation = code[:, :, 0], code[:, :, 1]
        own_mean, own_deviation = mine[:, None, 0], mine[:, None, 1]
        off = ((mean - own_mean) / own_deviation).square()
        total = total + (off + (deviation / own_deviation).log().square()).mean(dim=-1)
    return (-total / OWN**2).exp()


def statistics(x: Float[Tensor, "scenes views 64 h w"]) -> tuple[Tensor, Tensor]:
    """Mean and deviation of each channel over all views and places, (scenes, 1, 64, 1, 1)."""
    mean = x.mean(dim=(1, 3, 4), keepdim=True)
    variance = (x - mean).square().mean(dim=(1, 3, 4), keepdim=True)
    return mean, (variance + EPS).sqrt()


def adapt(x: Float[Tensor, "batch 64 h w"], code: Tensor, views: int) -> Tensor:
    """Adaptive instance norm, over all views of a scene together so that they stay alike."""
    scenes = x.float().unflatten(0, (-1, views))
    mean, deviation = statistics(scenes)
    style_mean, style_deviation = (code[:, None, row, :, None, None] for row in (0, 1))
    return ((scenes - mean) / deviation * style_deviation + style_mean).flatten(0, 1).to(x.dtype)


def modulation(code: Float[Tensor, "scenes 4 64"], views: int) -> tuple[Tensor, Tensor]:
    """Weight and bias of each channel, for every view."""
    weight, bias = (
        code[:, None, row, :, None, None].expand(-1, views, -1, -1, -1).flatten(0, 1)
        for row in (2, 3)
    )
    return weight, bias
