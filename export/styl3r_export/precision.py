"""Which weights are stored in half precision, decided in one place for graphs and for tests."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from styl3r_export.quantise.storage import HALF_MIN_ELEMENTS, stored_in_half, to_half

__all__ = ["HALF_MIN_ELEMENTS", "round_weights", "rounded", "stored_in_half", "to_half"]


@torch.no_grad()
def round_weights(model: nn.Module) -> None:
    """Give a model, in place, the weights that a graph with half precision weights has."""
    for parameter in model.parameters():
        if stored_in_half(parameter.numel()):
            parameter.copy_(rounded(parameter))


def rounded(weight: Tensor) -> Tensor:
    """A weight after its trip through half precision."""
    return weight.half().to(weight.dtype)
