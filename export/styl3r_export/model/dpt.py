"""Dense prediction heads: from hooked tokens to one vector a pixel (spec section 3)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from styl3r_export.model.config import ModelConfig
from styl3r_export.model.stem import Pyramid, PyramidStem

# Channels of the structure head's output: opacity logit, three scales, quaternion x y z w.
STRUCTURE_CHANNELS = 8


def upsample(x: Float[Tensor, "batch channels h w"]) -> Tensor:
    """Twice the size, bilinear with aligned corners, as every upsampling of the network."""
    return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=True)


class ResidualConvUnit(nn.Module):
    """Two 3x3 convolutions around the identity."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(features, features, 3, padding=1)
        self.conv2 = nn.Conv2d(features, features, 3, padding=1)

    def forward(self, x: Float[Tensor, "batch c h w"]) -> Float[Tensor, "batch c h w"]:
        """The raw x plus what the convolutions make of its positive part."""
        return x + self.conv2(F.relu(self.conv1(F.relu(x))))


class FusionBlock(nn.Module):
    """Merge a coarser path with a finer map, and double its size."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.out_conv = nn.Conv2d(features, features, 1)
        self.resConfUnit1 = ResidualConvUnit(features)
        self.resConfUnit2 = ResidualConvUnit(features)

    def forward(self, path: Tensor, skip: Tensor | None = None) -> Tensor:
        """Convolve before upsampling: a 1x1 convolution commutes with it, at a quarter the cost."""
        y = path if skip is None else path + self.resConfUnit1(skip)
        return upsample(self.out_conv(self.resConfUnit2(y)))


class Scratch(nn.Module):
    """The fusion path, under the names that published checkpoints use."""

    def __init__(self, maps: Sequence[int], features: int) -> None:
        super().__init__()
        for level, channels in enumerate(maps, start=1):
            conv = nn.Conv2d(channels, features, 3, padding=1, bias=False)
            self.add_module(f"layer{level}_rn", conv)
        # The same four convolutions a second time: checkpoints list both names.
        self.layer_rn = nn.ModuleList(self.get_submodule(f"layer{n}_rn") for n in (1, 2, 3, 4))
        for level in (1, 2, 3, 4):
            self.add_module(f"refinenet{level}", FusionBlock(features))

    def forward(self, maps: Sequence[Tensor]) -> Float[Tensor, "batch features H/2 W/2"]:
        """Fuse the four maps (fine to coarse) into one at half the picture's size."""
        one, two, three, four = (conv(m) for conv, m in zip(self.layer_rn, maps, strict=True))
        rows, columns = three.shape[-2:]
        # Odd grids: the coarsest map was rounded up, so its upsampled path is one too large.
        path = self.get_submodule("refinenet4")(four)[..., :rows, :columns]
        path = self.get_submodule("refinenet3")(path, three)
        path = self.get_submodule("refinenet2")(path, two)
        return self.get_submodule("refinenet1")(path, one)


class StemSkip(nn.Module):
    """Where a convolutional stem's maps enter a head: added at 1/2, 1/4 and 1/8."""

    def __init__(self, maps: Sequence[int], features: int) -> None:
        super().__init__()
        half, quarter, eighth = PyramidStem.CHANNELS
        self.at_half = nn.Conv2d(half, features, 1)
        self.at_quarter = nn.Conv2d(quarter, maps[0], 1)
        self.at_eighth = nn.Conv2d(eighth, maps[1], 1)


class Trunk(nn.Module):
    """Reassemble the hooked tokens into maps at 1/4, 1/8, 1/16, 1/32, and fuse them."""

    def __init__(self, config: ModelConfig, *, stem_skip: bool) -> None:
        super().__init__()
        a, b, c, d = config.head_maps
        wide, narrow = config.encoder_dim, config.decoder_dim
        self.act_postprocess = nn.ModuleList(
            [
                nn.Sequential(nn.Conv2d(wide, a, 1), nn.ConvTranspose2d(a, a, 4, 4)),
                nn.Sequential(nn.Conv2d(narrow, b, 1), nn.ConvTranspose2d(b, b, 2, 2)),
                nn.Sequential(nn.Conv2d(narrow, c, 1)),
                nn.Sequential(nn.Conv2d(narrow, d, 1), nn.Conv2d(d, d, 3, 2, 1)),
            ]
        )
        self.scratch = Scratch(config.head_maps, config.head_features)
        self.stem_skip = StemSkip(config.head_maps, config.head_features) if stem_skip else None

    def fuse(
        self, hooks: Sequence[Tensor], rows: int, columns: int, pyramid: Pyramid | None
    ) -> Float[Tensor, "batch features H/2 W/2"]:
        """The fused map at half the picture's size."""
        maps = [
            post(tokens.transpose(1, 2).unflatten(2, (rows, columns)))
            for post, tokens in zip(self.act_postprocess, hooks, strict=True)
        ]
        if self.stem_skip is None:
            return self.scratch(maps)
        assert pyramid is not None
        maps[0] = maps[0] + self.stem_skip.at_quarter(pyramid.quarter)
        maps[1] = maps[1] + self.stem_skip.at_eighth(pyramid.eighth)
        return self.scratch(maps) + self.stem_skip.at_half(pyramid.half)


class PointTrunk(Trunk):
    """Points: the last convolutions run at half size, then at full size."""

    def __init__(self, config: ModelConfig, out_channels: int) -> None:
        super().__init__(config, stem_skip=config.stem == "pyramid")
        inner = config.point_features
        self.head = nn.Sequential(
            nn.Conv2d(config.head_features, inner, 3, padding=1),
            nn.Identity(),  # the upsampling's place in published checkpoints
            nn.Conv2d(inner, inner, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(inner, out_channels, 1),
        )

    def forward(
        self, hooks: Sequence[Tensor], rows: int, columns: int, pyramid: Pyramid | None = None
    ) -> Float[Tensor, "batch channels H W"]:
        """Raw channels a pixel."""
        x = upsample(self.head[0](self.fuse(hooks, rows, columns, pyramid)))
        return self.head[4](F.relu(self.head[2](x)))


class GaussianTrunk(Trunk):
    """Structure or colours: the last convolutions run at full size, beside the picture's own."""

    def __init__(self, config: ModelConfig, out_channels: int, *, with_image: bool) -> None:
        super().__init__(config, stem_skip=with_image and config.stem == "pyramid")
        features = config.head_features
        self.head = nn.Sequential(
            nn.Conv2d(features, features, 3, padding=1, bias=False),
            nn.Identity(),
            nn.ReLU(),
            nn.Identity(),
            nn.Conv2d(features, out_channels, 1),
        )
        self.with_image = with_image
        if with_image:
            self.input_merger = nn.Sequential(nn.Conv2d(3, features, 7, padding=3), nn.ReLU())

    def forward(
        self,
        hooks: Sequence[Tensor],
        rows: int,
        columns: int,
        images: Float[Tensor, "batch 3 H W"] | None = None,
        pyramid: Pyramid | None = None,
    ) -> Float[Tensor, "batch channels H W"]:
        """Raw channels a pixel; `images` in [-1, 1]."""
        x = upsample(self.fuse(hooks, rows, columns, pyramid))
        if self.with_image:
            x = x + self.input_merger(images)
        return self.head[4](F.relu(self.head[0](x)))


class Head(nn.Module):
    """A trunk under the prefix `dpt`, as published checkpoints name it."""

    def __init__(self, dpt: Trunk) -> None:
        super().__init__()
        self.dpt = dpt

    def forward(self, *args: Tensor | int | Sequence[Tensor] | None) -> Tensor:
        """Raw channels in float32, whatever precision the tokens have."""
        out = self.dpt(*args)
        return out.float() if out.dtype != torch.float32 else out
