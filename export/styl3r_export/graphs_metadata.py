"""What each graph says about itself, and where its weights came from."""

from __future__ import annotations

import hashlib
import json
import platform
from dataclasses import dataclass
from importlib.metadata import version

import onnx_ir as ir
import torch

from styl3r_cli import __version__, manifest
from styl3r_export.model.config import PATCH
from styl3r_export.model.network import Styl3r

# Every network reads a painting in [0, 1]; the published ones read a content photo that stands
# in for a style in [-1, 1] (spec section 7), mini in [0, 1] too.
PAINTING_RANGE = (0.0, 1.0)
PHOTO_AS_STYLE_RANGES = {"signed": (-1.0, 1.0), "unit": (0.0, 1.0)}
# Height and width of the pictures that all published networks, and mini, were trained with.
TRAINED_SIZE = (16 * PATCH, 16 * PATCH)

OWN_LICENCE = "Apache-2.0"
# The published weights were trained from MASt3R's, whose terms they inherit.
PUBLISHED_LICENCE = "see huggingface.co/WangPng/Styl3R; trained from MASt3R (CC-BY-NC-SA-4.0)"


@dataclass(frozen=True)
class Provenance:
    """Where a model's weights came from.

    Attributes:
        version: which training of the network, such as "re10k_2v".
        licence: of the weights.
        source_sha256: of the checkpoint file, empty when there was none.
    """

    version: str
    licence: str
    source_sha256: str = ""


@torch.no_grad()
def weights_id(model: Styl3r) -> str:
    """A fingerprint of configuration and weights, which both graphs of a model share."""
    digest = hashlib.sha256(json.dumps(model.config.to_dict(), sort_keys=True).encode())
    for name, parameter in sorted(model.named_parameters()):
        digest.update(f"{name} {tuple(parameter.shape)}".encode())
        digest.update(parameter.detach().contiguous().numpy().data)
    return digest.hexdigest()


def describe(
    graph_model: ir.Model,
    graph: str,
    model: Styl3r,
    identity: str,
    provenance: Provenance,
    precision: str,
) -> None:
    """Write the properties that the loader reads into a graph, in place."""
    tools = ("torch", "onnx", "onnxscript", "onnx_ir", "onnxruntime")
    versions = {name: version(name) for name in tools} | {"python": platform.python_version()}
    config = model.config
    graph_model.metadata_props.update(
        {
            manifest.PROP_MODEL: config.name,
            manifest.PROP_MODEL_VERSION: provenance.version,
            manifest.PROP_GRAPH: graph.removesuffix(".onnx"),
            manifest.PROP_WEIGHTS_ID: identity,
            manifest.PROP_CONFIG: json.dumps(config.to_dict()),
            manifest.PROP_SOURCE: provenance.source_sha256,
            manifest.PROP_LICENCE: provenance.licence,
            manifest.PROP_PRECISION: precision,
            manifest.PROP_TOOLS: json.dumps(versions),
            manifest.PROP_VERSION: __version__,
            manifest.PROP_PAINTING_RANGE: json.dumps(PAINTING_RANGE),
            manifest.PROP_PHOTO_RANGE: json.dumps(PHOTO_AS_STYLE_RANGES[config.photo_as_style]),
            manifest.PROP_PICTURES: json.dumps(config.colours == "strokes"),
            manifest.PROP_INPUT_SIZE: json.dumps(TRAINED_SIZE),
        }
    )
    graph_model.producer_name = "styl3r"
    graph_model.producer_version = __version__
    graph_model.graph.name = f"{config.name} {graph.removesuffix('.onnx')}"
