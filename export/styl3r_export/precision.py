"""Which weights are stored in half precision, decided in one place for graphs and for tests."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from styl3r_cli.errors import ModelError

# Tensors below this size stay float32: biases, norms, the heads' last convolutions, the camera
# token. They are sensitive, and together less than 2 % of the weights.
HALF_MIN_ELEMENTS = 16384
HALF_MAX = float(np.finfo(np.float16).max)


def stored_in_half(elements: int) -> bool:
    """Whether a weight with this many elements is stored in half precision."""
    return elements >= HALF_MIN_ELEMENTS


def to_half(values: npt.NDArray[np.float32], name: str) -> npt.NDArray[np.float16]:
    """The nearest half precision values.

    Raises:
        ModelError: a value is too large for half precision, or not finite.
    """
    if not np.abs(values).max(initial=0.0) <= HALF_MAX:
        raise ModelError(f"{name}: values beyond half precision's {HALF_MAX:g}; export as fp32")
    return values.astype(np.float16)


@torch.no_grad()
def round_weights(model: nn.Module) -> None:
    """Give a model, in place, the weights that a graph with half precision weights has."""
    for parameter in model.parameters():
        if stored_in_half(parameter.numel()):
            parameter.copy_(rounded(parameter))


def rounded(weight: Tensor) -> Tensor:
    """A weight after its trip through half precision."""
    return weight.half().to(weight.dtype)
