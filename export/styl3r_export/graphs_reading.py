"""Exported graphs back into a torch model, so that training or another export can start there."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnx_ir as ir
import torch

from styl3r_cli import manifest as manifests
from styl3r_cli.errors import ModelError, shortened
from styl3r_export.checkpoints import canonical, empty_model, listed
from styl3r_export.graph_passes import TRANSPOSED
from styl3r_export.graphs_metadata import Provenance
from styl3r_export.model import ModelConfig, Styl3r


def load_graphs(folder: Path) -> tuple[Styl3r, Provenance]:
    """The model that two graphs were exported from, with the weights they store.

    Weights in half precision come back as float32 with half precision's values. Parameters that
    no output depends on are in no graph, and come back as zeros.

    Args:
        folder: what `styl3r export` wrote.

    Returns:
        The model (eval mode, float32, CPU), and where its weights came from.

    Raises:
        ModelError: a file is missing or damaged, or the graphs do not belong together.
    """
    manifest = manifests.read_manifest(folder)
    if manifest.precision not in ("fp32", "fp16"):
        message = f"{folder}: its weights are {manifest.precision}"
        raise ModelError(f"{message}; start from the model that it was made from")
    for name in manifest.files:
        manifests.check_file(folder, name, manifest)
    try:
        graphs = [ir.load(folder / name) for name in (manifests.STRUCTURE, manifests.APPEARANCE)]
        properties = graphs[0].metadata_props
        if any(_weights_id(g) != manifest.weights_id for g in graphs):
            raise ModelError(f"{folder}: the graphs do not belong together; export the model again")
        model = empty_model(ModelConfig.from_dict(json.loads(properties[manifests.PROP_CONFIG])))
        weights = {n: t for g in graphs for n, t in _weights(g).items()}
        provenance = Provenance(
            properties[manifests.PROP_MODEL_VERSION],
            properties[manifests.PROP_LICENCE],
            properties[manifests.PROP_SOURCE],
        )
    except ModelError:
        raise
    except Exception as error:  # graphs that another program wrote can raise anything
        message = f"{folder}: no graphs of this project ({shortened(str(error))})"
        raise ModelError(f"{message}; export the model again") from error
    return _filled(folder, model, weights), provenance


def _weights_id(graph_model: ir.Model) -> str | None:
    return graph_model.metadata_props.get(manifests.PROP_WEIGHTS_ID)


def _weights(graph_model: ir.Model) -> dict[str, torch.Tensor]:
    """All initializers in the parameters' orientation, float32, under their canonical names."""
    found = {}
    for name, value in graph_model.graph.initializers.items():
        assert value.const_value is not None
        array = value.const_value.numpy()
        if name.endswith(TRANSPOSED):
            array = array.T
        if array.dtype in (np.float16, np.float32):
            copy = np.array(array, dtype=np.float32, order="C")
            found[canonical(name.removesuffix(TRANSPOSED))] = torch.from_numpy(copy)
    return found


def _filled(folder: Path, model: Styl3r, weights: dict[str, torch.Tensor]) -> Styl3r:
    state = {}
    for name, ours in model.state_dict().items():
        value = weights.get(canonical(name))
        if value is None and is_needed(name):
            message = f"{folder}: the graphs have no {listed([name])}; export the model again"
            raise ModelError(message)
        state[name] = torch.zeros(ours.shape) if value is None else value
        if state[name].shape != ours.shape:
            raise ModelError(f"{folder}: {name} has another shape; export the model again")
    model.load_state_dict(state, strict=True, assign=True)
    return model


def is_needed(name: str) -> bool:
    """Whether any output depends on a parameter (every checkpoint holds some that do nothing)."""
    return not (name.endswith("mask_token") or ".refinenet4.resConfUnit1." in name)
