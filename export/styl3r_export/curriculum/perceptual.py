"""Frozen perceptual networks behind one interface: four depths of features of a picture."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from styl3r_cli.errors import InputError
from styl3r_export.curriculum.layout import channels_last
from styl3r_export.curriculum.teachers import load_npz
from styl3r_export.safe_pickle import read_checkpoint

# Stabilises the standard deviation of constant features (published).
STD_EPS = 1e-8
# Added to the size of features that distances are divided by; they are 1 and more.
STATISTICS_EPS = 1e-3


class Perceptual(Protocol):
    """Features at four depths (relu1_1, relu2_1, relu3_1, relu4_1) of pictures in [0, 1]."""

    def __call__(self, images: Float[Tensor, "batch 3 h w"]) -> list[Tensor]:
        """From shallow to deep."""
        ...


class SlimVgg(nn.Module):
    """VGG19 slimmed 16x by Collaborative Distillation (Wang et al., CVPR 2020; MIT)."""

    # Convolutions of each level; a 2x2 maximum stands between levels.
    LEVELS = (("conv11",), ("conv12", "conv21"), ("conv22", "conv31"),
              ("conv32", "conv33", "conv34", "conv41"))  # fmt: skip
    POOLED = ("conv21", "conv31", "conv41")

    def __init__(self, weights: Path, *, widened: bool = True) -> None:
        """`widened`: with the 1x1 convolutions to VGG19's own channels (several times the cost)."""
        super().__init__()
        arrays = load_npz(weights)
        self.widened = widened
        names = ["conv0", *(name for level in self.LEVELS for name in level)]
        if widened:
            names += [f"{level[-1]}_aux" for level in self.LEVELS]
        self.convs = nn.ModuleDict()
        for name in names:
            weight = arrays[f"{name}.weight"]
            conv = nn.Conv2d(weight.shape[1], weight.shape[0], weight.shape[2])
            conv.load_state_dict({"weight": weight, "bias": arrays[f"{name}.bias"]})
            self.convs[name] = conv
        self.requires_grad_(False)

    def forward(self, images: Float[Tensor, "batch 3 h w"]) -> list[Tensor]:
        """The stand-ins for VGG19's relu1_1, relu2_1, relu3_1 and relu4_1."""
        x = self.convs["conv0"](images)
        features = []
        for level in self.LEVELS:
            for name in level:
                if name in self.POOLED:
                    x = F.max_pool2d(x, 2)
                x = F.relu(self.convs[name](F.pad(x, (1, 1, 1, 1), mode="reflect")))
            wide = F.relu(self.convs[f"{level[-1]}_aux"](x)) if self.widened else x
            features.append(wide)
        return features


class TorchvisionVgg(nn.Module):
    """The paper's perceptual network: VGG19 with torchvision's ImageNet weights (a .pth file)."""

    MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
    # Layout of `features`: channels of each 3x3 convolution, "M" for a 2x2 maximum.
    LAYOUT = (64, 64, "M", 128, 128, "M", 256, 256, 256, 256, "M", 512)
    TAPS = (1, 6, 11, 20)  # relu1_1, relu2_1, relu3_1, relu4_1

    mean: Tensor
    std: Tensor

    def __init__(self, weights: Path) -> None:
        """Read a state dict by torchvision's names (`features.N.weight`, `features.N.bias`).

        Raises:
            InputError: the file is missing, or does not hold these layers.
        """
        super().__init__()
        layers: list[nn.Module] = []
        channels = 3
        for entry in self.LAYOUT:
            if entry == "M":
                layers.append(nn.MaxPool2d(2))
            else:
                layers += [nn.Conv2d(channels, int(entry), 3, padding=1), nn.ReLU()]
                channels = int(entry)
        self.features = nn.Sequential(*layers)
        self.load_state_dict(_layers_of(weights, self.state_dict()))
        self.register_buffer("mean", torch.tensor(self.MEAN).view(3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(self.STD).view(3, 1, 1), persistent=False)
        self.requires_grad_(False)

    def forward(self, images: Float[Tensor, "batch 3 h w"]) -> list[Tensor]:
        """relu1_1, relu2_1, relu3_1 and relu4_1."""
        x, features = (images - self.mean) / self.std, []
        for index, layer in enumerate(self.features):
            x = layer(x)
            if index in self.TAPS:
                features.append(x)
        return features


def _layers_of(weights: Path, wanted: dict[str, Tensor]) -> dict[str, Tensor]:
    """The wanted entries of a state dict in a file; it may hold more.

    Raises:
        InputError: the file is missing, or lacks one, or has it in another shape.
    """
    state = read_checkpoint(weights)
    found = state if isinstance(state, Mapping) else {}
    for name, value in wanted.items():
        have = found.get(name)
        shape = tuple(have.shape) if isinstance(have, Tensor) else "missing"
        if shape != tuple(value.shape):
            raise InputError(
                f"{weights}: not torchvision's VGG19: {name} is {shape}, "
                f"expected {tuple(value.shape)}; name its vgg19-*.pth file"
            )
    return {name: found[name].float() for name in wanted}


def load_perceptual(weights: Path) -> nn.Module:
    """The network whose weights a file holds: .npz is the slim VGG19, else torchvision's."""
    slim = weights.suffix == ".npz"
    network: nn.Module = SlimVgg(weights, widened=False) if slim else TorchvisionVgg(weights)
    channels_last(network)
    return network


def statistics(
    features: Float[Tensor, "batch channels h w"],
) -> tuple[Float[Tensor, "batch channels"], Float[Tensor, "batch channels"]]:
    """Channel means and (unbiased) standard deviations."""
    flat = features.flatten(2)
    return flat.mean(dim=2), (flat.var(dim=2) + STD_EPS).sqrt()


def style_distance(a: list[Tensor], b: list[Tensor]) -> Tensor:
    """Sum over depths of the squared differences of means and of standard deviations."""
    total = a[0].new_zeros(())
    for x, y in zip(a, b, strict=True):
        (mean_x, std_x), (mean_y, std_y) = statistics(x), statistics(y)
        total = total + F.mse_loss(mean_x, mean_y) + F.mse_loss(std_x, std_y)
    return total


def relative_style_distance(a: list[Tensor], b: list[Tensor]) -> Tensor:
    """The style distance with every depth relative to `b`'s features there, so that all count.

    The slim VGG19's own features are 15 times as strong at its second depth as at its deepest:
    the plain sum is of shallow ones alone.
    """
    parts = [
        style_distance([x], [y]) / (y.square().mean() + STATISTICS_EPS)
        for x, y in zip(a, b, strict=True)
    ]
    return torch.stack(parts).sum()


def content_distance(a: list[Tensor], b: list[Tensor]) -> Tensor:
    """Squared differences at the two deepest features (paper, content loss)."""
    return F.mse_loss(a[2], b[2]) + F.mse_loss(a[3], b[3])
