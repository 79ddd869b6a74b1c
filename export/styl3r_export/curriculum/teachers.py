"""Weights trained elsewhere that training leans on, read from plain .npz files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from styl3r_export.model import Styl3r
from styl3r_export.model.flow import Flow
from styl3r_export.model.stem import PyramidStem


def load_npz(path: Path) -> dict[str, Tensor]:
    """All arrays of a file as float32 tensors.

    Raises:
        FileNotFoundError: there is no such file.
        TypeError, ValueError: it holds something else.
    """
    with np.load(path, allow_pickle=False) as arrays:
        return {name: torch.from_numpy(np.array(arrays[name], np.float32)) for name in arrays.files}


def initialise_flow(model: Styl3r, raft: Path) -> None:
    """Load RAFT-small into a network's stem and matching."""
    load_flow(model.backbone.stem, model.matching.flow, raft)


def load_flow(stem: PyramidStem, flow: Flow, raft: Path) -> None:
    """RAFT-small (Teed and Deng, ECCV 2020; BSD-3): both encoders and the recurrent unit.

    Raises:
        FileNotFoundError: there is no such file.
    """
    weights = {n.replace("downsample.0", "downsample"): v for n, v in load_npz(raft).items()}
    parts = {"fnet.": stem, "cnet.": flow.cnet, "update_block.": flow.update_block}
    for prefix, part in parts.items():
        part.load_state_dict(
            {n.removeprefix(prefix): v for n, v in weights.items() if n.startswith(prefix)}
        )


def initialise_strokes(model: Styl3r, microast: Path) -> None:
    """Load MicroAST (Wang et al., AAAI 2023; MIT) as the appearance branch."""
    model.strokes.load_state_dict(load_npz(microast))
