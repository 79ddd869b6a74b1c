"""A small network of the published layout, and files of it."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import nn

from styl3r_export.model import FULL

TINY = replace(
    FULL,
    head_dim=8,
    encoder_dim=16,
    encoder_depth=2,
    style_depth=1,
    decoder_dim=8,
    decoder_depth=3,
    stylizer_depth=3,
    hooks=(1, 2, 3),
    head_maps=(3, 4, 5, 6),
    head_features=4,
    point_features=4,
)


def lightning(model: nn.Module) -> dict[str, Any]:
    """A Lightning file's contents."""
    state = OrderedDict((f"encoder.{n}", v) for n, v in model.state_dict().items())
    return {"epoch": 3, "global_step": 35000, "state_dict": state}


def saved(path: Path, content: object) -> Path:
    torch.save(content, path)
    return path


def assert_same(a: nn.Module, b: nn.Module) -> None:
    ours, theirs = a.state_dict(), b.state_dict()
    assert ours.keys() == theirs.keys()
    assert all(torch.equal(ours[n], theirs[n]) for n in ours)
