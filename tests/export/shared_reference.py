"""Where the published network's facts lie, and the model filled with their test weights."""

from __future__ import annotations

import importlib.util
import json
import os
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch

from styl3r_export.model import FULL, Styl3r


def reference_folder() -> Path:
    """The folder with the published network's facts; the test is skipped where there is none."""
    beside = Path(__file__).parents[3] / "shared"
    folder = Path(os.environ.get("STYL3R_SHARED", beside)) / "reference"
    if not folder.is_dir():
        pytest.skip("the reference data is not here (set STYL3R_SHARED to its folder)")
    return folder


@cache
def recipe() -> ModuleType:
    """The module that makes the reference's weights and inputs."""
    spec = importlib.util.spec_from_file_location(
        "weights_recipe", reference_folder() / "weights_recipe.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def state_entries() -> list[dict[str, Any]]:
    """Name and shape of every entry of a published checkpoint."""
    path = reference_folder() / "styl3r_state_dict.json"
    return json.loads(path.read_text(encoding="utf-8"))["entries"]


def arrays(name: str) -> dict[str, np.ndarray]:
    """All arrays of one of the reference's archives."""
    with np.load(reference_folder() / name) as archive:
        return {key: archive[key] for key in archive.files}


def full_with_test_weights() -> Styl3r:
    """The published network with the recipe's weights, 4.2 GB, never held twice."""
    made: dict[str, torch.Tensor] = {}
    state = {}
    for entry in state_entries():
        key = recipe().canonical_name(entry["name"])
        if key not in made:
            made[key] = torch.from_numpy(recipe().make_weights(entry["name"], entry["shape"]))
        state[entry["name"]] = made[key]
    with torch.device("meta"):
        model = Styl3r(FULL)
    model.load_state_dict(state, strict=True, assign=True)
    return model.eval().requires_grad_(False)


def rel_rms(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Root mean square of the difference over that of the expected values."""
    difference = ours.astype(np.float64) - theirs
    return float(np.sqrt((difference**2).mean() / (theirs.astype(np.float64) ** 2).mean()))
