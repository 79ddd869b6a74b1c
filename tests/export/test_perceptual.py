"""VGG19 from a torchvision state dict: the paper's perceptual network."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

from styl3r_cli.errors import InputError
from styl3r_export.curriculum.perceptual import (
    TorchvisionVgg,
    content_distance,
    load_perceptual,
    style_distance,
)

# Number and channels of the convolutions of torchvision's `vgg19().features` up to conv4_1.
CONVOLUTIONS = {0: (3, 64), 2: (64, 64), 5: (64, 128), 7: (128, 128), 10: (128, 256),
                12: (256, 256), 14: (256, 256), 16: (256, 256), 19: (256, 512)}  # fmt: skip


@pytest.fixture(scope="module")
def state() -> dict[str, Tensor]:
    """Random weights by torchvision's names, with what a whole VGG19 has beyond."""
    generator = torch.Generator().manual_seed(3)
    entries = {
        "features.21.weight": torch.zeros(512, 512, 3, 3),
        "classifier.6.bias": torch.ones(9),
    }
    for number, (before, after) in CONVOLUTIONS.items():
        scale = (2 / (9 * before)) ** 0.5
        weight = torch.randn(after, before, 3, 3, generator=generator) * scale
        entries[f"features.{number}.weight"] = weight
        entries[f"features.{number}.bias"] = torch.randn(after, generator=generator) * 0.1
    return entries


@pytest.fixture(scope="module")
def weights(state: dict[str, Tensor], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("vgg") / "vgg19.pth"
    torch.save(state, path)
    return path


def restated(images: Tensor, state: dict[str, Tensor]) -> list[Tensor]:
    """relu1_1, relu2_1, relu3_1 and relu4_1 in float64, one layer a line."""
    w = {name: value.double() for name, value in state.items()}

    def conv(x: Tensor, number: int) -> Tensor:
        weight, bias = w[f"features.{number}.weight"], w[f"features.{number}.bias"]
        return F.conv2d(x, weight, bias, padding=1).clamp_min(0)

    mean = torch.tensor([0.485, 0.456, 0.406], dtype=torch.float64).view(1, 3, 1, 1)
    std = torch.tensor([0.229, 0.224, 0.225], dtype=torch.float64).view(1, 3, 1, 1)
    relu1_1 = conv((images.double() - mean) / std, 0)
    relu2_1 = conv(F.max_pool2d(conv(relu1_1, 2), 2), 5)
    relu3_1 = conv(F.max_pool2d(conv(relu2_1, 7), 2), 10)
    relu3_4 = conv(conv(conv(relu3_1, 12), 14), 16)
    relu4_1 = conv(F.max_pool2d(relu3_4, 2), 19)
    return [relu1_1, relu2_1, relu3_1, relu4_1]


def test_features_are_torchvision_s_layers(weights: Path, state: dict[str, Tensor]) -> None:
    images = torch.rand(2, 3, 48, 40, generator=torch.Generator().manual_seed(0))
    network = load_perceptual(weights)
    assert isinstance(network, TorchvisionVgg)
    found, expected = network(images), restated(images, state)
    shapes = [(2, 64, 48, 40), (2, 128, 24, 20), (2, 256, 12, 10), (2, 512, 6, 5)]
    assert [tuple(f.shape) for f in found] == shapes
    for ours, theirs in zip(found, expected, strict=True):
        torch.testing.assert_close(ours.double(), theirs, rtol=1e-4, atol=1e-4)
    assert not any(p.requires_grad for p in network.parameters())


def test_losses_reach_the_picture(weights: Path) -> None:
    network = load_perceptual(weights)
    picture, other = torch.full((1, 3, 32, 32), 0.4, requires_grad=True), torch.rand(1, 3, 32, 32)
    features = network(other)
    loss = style_distance(network(picture), features) + content_distance(network(picture), features)
    (gradient,) = torch.autograd.grad(loss, picture)
    assert float(gradient.abs().min(dim=1).values.max()) > 0
    moved = picture.detach() - 1e-3 * gradient / gradient.norm()
    again = network(moved)
    assert style_distance(again, features) + content_distance(again, features) < loss


@pytest.mark.parametrize("kind", ["missing", "lacking", "reshaped", "a list"])
def test_other_files_are_refused(kind: str, state: dict[str, Tensor], tmp_path: Path) -> None:
    path, entries = tmp_path / "weights.pth", dict(state)
    if kind == "lacking":
        del entries["features.16.bias"]
    if kind == "reshaped":  # as VGG16's is, whose layers are numbered otherwise
        entries["features.19.weight"] = torch.zeros(512, 512, 3, 3)
    if kind != "missing":
        torch.save([1] if kind == "a list" else entries, path)
    with pytest.raises(InputError, match=r"weights\.pth"):
        load_perceptual(path)
