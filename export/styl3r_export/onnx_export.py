"""The two graphs: traced by torch's exporter, simplified, described and written."""

from __future__ import annotations

import contextlib
import io
import logging
import math
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import onnx_ir as ir
import torch
from jaxtyping import Float
from onnxscript import opset20 as op
from torch import Tensor, nn
from torch.export import Dim

from styl3r_cli.manifest import APPEARANCE, MANIFEST, STRUCTURE, Manifest, describe_files
from styl3r_export import graph_passes
from styl3r_export.graphs_metadata import Provenance, describe, weights_id
from styl3r_export.model.config import PATCH
from styl3r_export.model.network import Styl3r
from styl3r_export.quantise.folders import EXTERNAL_ABOVE

Precision = Literal["fp32", "fp16"]

# The operator set of the graphs: the first with GELU and with half precision everywhere, and
# old enough for every onnxruntime that the command accepts.
OPSET = 20
SDPA = torch.ops.aten.scaled_dot_product_attention.default

# Sizes that the trace sees: all different, so that no two axes are taken for one.
TRACE_VIEWS, TRACE_STYLES = 3, 2
TRACE_GRID, TRACE_STYLE_GRID = (3, 5), (4, 6)
# Largest patch grid side that the tracer is told of (a bound for its reasoning, not for the
# graph's users).
MAX_GRID = 256
MAX_VIEWS, MAX_STYLES = 8, 64


class StructureGraph(nn.Module):
    """`Styl3r.structure` as a module, for the tracer."""

    def __init__(self, model: Styl3r) -> None:
        super().__init__()
        self.model = model

    def forward(
        self, images: Float[Tensor, "views 3 H W"], intrinsics: Float[Tensor, "views 3 3"]
    ) -> tuple[Tensor, ...]:
        """The outputs in the contract's order."""
        return tuple(self.model.structure(images, intrinsics))


class AppearanceGraph(nn.Module):
    """`Styl3r.appearance` as a module, for the tracer."""

    def __init__(self, model: Styl3r) -> None:
        super().__init__()
        self.model = model

    def forward(
        self, content_tokens: Tensor, style_images: Tensor, style_weights: Tensor, images: Tensor
    ) -> Float[Tensor, "views H W 3"]:
        """The colours.

        The published colour head does not read the images' values, but their size: tokens alone
        do not tell a 3 x 5 grid from a 5 x 3 one.
        """
        return self.model.appearance(content_tokens, style_images, style_weights, images)


def trace_structure(model: Styl3r) -> ir.Model:
    """The structure graph, unsimplified; views, height and width are dynamic."""
    rows, columns = TRACE_GRID
    images = torch.rand(TRACE_VIEWS, 3, PATCH * rows, PATCH * columns)
    intrinsics = torch.eye(3).expand(TRACE_VIEWS, 3, 3).contiguous()
    views, height, width = _view_dims()
    return trace(
        StructureGraph(model),
        {"images": images, "intrinsics": intrinsics},
        {"images": {0: views, 2: height, 3: width}, "intrinsics": {0: views}},
        ["means", "scales", "rotations", "opacities", "content_tokens"],
    )


def trace_appearance(model: Styl3r) -> ir.Model:
    """The appearance graph, unsimplified; views, styles and all sizes are dynamic."""
    (rows, columns), style_grid = TRACE_GRID, TRACE_STYLE_GRID
    views, height, width = _view_dims()
    styles = Dim("styles", min=1, max=MAX_STYLES)
    style_rows, style_columns = (Dim(n, max=MAX_GRID) for n in ("style_rows", "style_columns"))
    return trace(
        AppearanceGraph(model),
        {
            "content_tokens": torch.rand(TRACE_VIEWS, rows * columns + 1, model.config.encoder_dim),
            "style_images": torch.rand(TRACE_STYLES, 3, *(PATCH * n for n in style_grid)),
            "style_weights": torch.full((TRACE_STYLES,), 1 / TRACE_STYLES),
            "images": torch.rand(TRACE_VIEWS, 3, PATCH * rows, PATCH * columns),
        },
        {
            # The tracer finds out by itself that tokens = rows * columns + 1.
            "content_tokens": {0: views, 1: Dim.DYNAMIC},
            "style_images": {0: styles, 2: PATCH * style_rows, 3: PATCH * style_columns},
            "style_weights": {0: styles},
            "images": {0: views, 2: height, 3: width},
        },
        ["colours"],
    )


def _view_dims() -> tuple[Any, Any, Any]:
    # The trace assumes three views or more, because torch would treat "all views but one" as a
    # scalar axis otherwise. The graph runs with two as well; verification makes sure of it.
    views = Dim("views", min=3, max=MAX_VIEWS)
    return views, PATCH * Dim("rows", max=MAX_GRID), PATCH * Dim("columns", max=MAX_GRID)


def trace(
    module: nn.Module, inputs: dict[str, Tensor], dims: dict[str, Any], outputs: list[str]
) -> ir.Model:
    """A module's graph as torch's exporter makes it, without its simplifications.

    Args:
        module: in eval mode; initializers get its parameters' names.
        inputs: example inputs by name.
        dims: dynamic axes of each input.
        outputs: names of the outputs.
    """
    with torch.no_grad(), _silence():
        program = torch.onnx.export(
            module.eval(),
            kwargs=inputs,
            dynamo=True,
            dynamic_shapes=dims,
            input_names=list(inputs),
            output_names=outputs,
            opset_version=OPSET,
            custom_translation_table={SDPA: attention},
            optimize=False,
            verbose=False,
        )
    assert program is not None
    return program.model


def attention(query: Any, key: Any, value: Any, **_: Any) -> Any:
    """Softmax attention without mask, as the operators that runtimes know how to fuse.

    The exporter's own translation turns keys by way of three dimensions and scales both factors:
    ten operators more, and two copies, for each of a model's many attentions.
    """
    scale = 1 / math.sqrt(query.shape[-1])
    scores = op.MatMul(op.Mul(query, scale), op.Transpose(key, perm=[0, 1, 3, 2]))
    return op.MatMul(op.Softmax(scores, axis=-1), value)


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Keep the tracer's warnings about its own internals off the user's terminal."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def finish(graph_model: ir.Model, model: Styl3r, precision: Precision) -> None:
    """Simplify a traced graph and store its weights as asked, in place."""
    parameters = {name for name, _ in model.named_parameters(remove_duplicate=False)}
    graph = graph_model.graph
    graph_passes.name_weights(graph)
    graph_passes.name_sampling(graph)
    graph_passes.fold_transposes(graph)
    turned = {n for n in graph.initializers if graph_passes.parameter_name(n) in parameters}
    graph_passes.simplify(graph_model, turned)
    graph_passes.name_axes(graph)
    if precision == "fp16":
        graph_passes.halve_weights(graph, parameters)


def write_graph(graph_model: ir.Model, path: Path) -> None:
    """One file, and one beside it where the weights are too many for a protobuf message."""
    weights = sum(graph_passes.constant(v).nbytes for v in graph_model.graph.initializers.values())
    external = f"{path.name}.data" if weights > EXTERNAL_ABOVE else None
    ir.save(graph_model, path, external_data=external)


def write_graphs(
    model: Styl3r, folder: Path, provenance: Provenance, precision: Precision = "fp32"
) -> Manifest:
    """Write both graphs and their manifest into an existing folder, unverified.

    Args:
        model: in eval mode, float32, on the CPU.
        folder: where `structure.onnx`, `appearance.onnx` and `manifest.json` go, and a `.data`
            file beside a graph of over 2 GB.
        provenance: where the weights came from.
        precision: how weights are stored; edges and computation are float32 either way.
    """
    identity = weights_id(model)
    for name, tracer in ((STRUCTURE, trace_structure), (APPEARANCE, trace_appearance)):
        graph_model = tracer(model)
        finish(graph_model, model, precision)
        describe(graph_model, name, model, identity, provenance, precision)
        write_graph(graph_model, folder / name)
    result = Manifest(
        model.config.name, provenance.version, identity, precision, describe_files(folder)
    )
    (folder / MANIFEST).write_text(result.to_json(), encoding="utf-8")
    return result
