"""Weights trained elsewhere that training leans on, read from plain .npz files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from styl3r_export.model import Styl3r


def load_npz(path: Path) -> dict[str, Tensor]:
    """All arrays of a file as float32 tensors.

    Raises:
        FileNotFoundError: there is no such file.
    """
    with np.load(path, allow_pickle=False) as arrays:
        return {name: torch.from_numpy(arrays[name].astype(np.float32)) for name in arrays.files}


def initialise_stem(model: Styl3r, raft: Path) -> None:
    """Load RAFT-small's feature encoder (Teed and Deng, ECCV 2020; BSD-3) into the stem."""
    prefix = "fnet."
    weights = {
        name[len(prefix) :].replace("downsample.0", "downsample"): value
        for name, value in load_npz(raft).items()
        if name.startswith(prefix)
    }
    model.backbone.stem.load_state_dict(weights)
