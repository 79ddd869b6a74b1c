"""What is done to a traced graph before it is written: names kept, weights turned and halved."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import cast

import numpy as np
import onnx_ir as ir
import onnx_ir.passes.common as passes
from onnxscript import optimizer, rewriter

from styl3r_export.precision import stored_in_half, to_half

# Where the traced wrapper holds the model; without it, initializers have the checkpoint's names.
WRAPPED = "model."
# A matrix that is stored transposed, as matrix products read it: `<parameter>.T`.
TRANSPOSED = ".T"
# Names of the leading axes of inputs and outputs; all others lead with views, height, width.
AXES: dict[str, tuple[str | int, ...]] = {
    "images": ("views", 3, "height", "width"),
    "intrinsics": ("views",),
    "content_tokens": ("views", "tokens"),
    "style_images": ("styles", 3, "style_height", "style_width"),
    "style_weights": ("styles",),
}
# The rewriter takes what is no further from 0 or 1 for it; its own limits are 1e-8 and 1e-5.
ALMOST = 1e-4
# A half precision weight is cast back to float32 under this name's end.
WIDENED = "/float32"


def name_weights(graph: ir.Graph) -> None:
    """Initializers get the parameters' names, as in a checkpoint."""
    for name in [n for n in graph.initializers if n.startswith(WRAPPED)]:
        value = graph.initializers.pop(name)
        value.name = name.removeprefix(WRAPPED)
        graph.initializers.add(value)


def fold_transposes(graph: ir.Graph) -> None:
    """Store a linear layer's matrix as its product reads it, so that no loader has to turn it."""
    for node in list(graph):
        source = node.inputs[0] if node.op_type == "Transpose" else None
        if source is None or not source.is_initializer() or len(source.uses()) != 1:
            continue
        if list(node.attributes.get_ints("perm")) != [1, 0]:
            continue
        turned = ir.Value(name=f"{source.name}{TRANSPOSED}")
        _store(turned, _turned(constant(source)))
        node.outputs[0].replace_all_uses_with(turned)
        graph.remove(node, safe=True)
        graph.initializers.pop(str(source.name))
        graph.initializers.add(turned)


def name_sampling(graph: ir.Graph) -> None:
    """Bilinear sampling by its name of opset 20, also in loops, which the converter leaves out."""
    for node in graph.all_nodes():
        if node.op_type == "GridSample" and node.attributes.get_string("mode") == "bilinear":
            node.attributes["mode"] = ir.AttrString("mode", "linear")


def constant(value: ir.Value) -> ir.TensorProtocol:
    """An initializer's values."""
    assert value.const_value is not None
    return value.const_value


def sizes(tensor: ir.TensorProtocol) -> ir.Shape:
    """The tensor's shape, which is never symbolic."""
    return ir.Shape(cast("list[int]", list(tensor.shape)))


def _store(value: ir.Value, tensor: ir.LazyTensor) -> None:
    value.const_value, value.dtype = tensor, tensor.dtype
    value.shape = sizes(tensor)


def _turned(tensor: ir.TensorProtocol) -> ir.LazyTensor:
    """The transposed matrix, made when it is written: a full model is never held twice."""
    rows, columns = sizes(tensor)
    return ir.LazyTensor(
        lambda: ir.Tensor(np.ascontiguousarray(tensor.numpy().T)),
        dtype=tensor.dtype,
        shape=ir.Shape([columns, rows]),
    )


def simplify(model: ir.Model, parameters: set[str]) -> None:
    """Fold what does not depend on inputs, and drop what nothing reads; weights keep their names.

    Identical initializers are not merged, as the exporter's own optimiser would: two norms that
    happen to be equal are still two parameters.
    """

    def should_fold(node: ir.Node) -> bool | None:
        read = {v.name for v in node.inputs if v is not None}
        return False if read & parameters else None

    for _ in range(2):  # folding uncovers patterns for rewriting, and the other way round
        optimizer.fold_constants(model, should_fold=should_fold)
        passes.LiftConstantsToInitializersPass(lift_all_constants=True, size_limit=0)(model)
        with _almost_nothing_hidden(model.graph):
            rewriter.rewrite(model)
        passes.RemoveUnusedNodesPass()(model)
        passes.LiftConstantsToInitializersPass(lift_all_constants=True, size_limit=0)(model)
        # No pass drops or merges what only a loop's body holds.
        passes.LiftSubgraphInitializersToMainGraphPass()(model)
        merge_constants(model.graph, parameters)
        passes.CommonSubexpressionEliminationPass()(model)
    passes.RemoveUnusedFunctionsPass()(model)
    passes.RemoveUnusedOpsetsPass()(model)
    passes.IdentityEliminationPass()(model)
    passes.RemoveUnusedNodesPass()(model)
    passes.ClearMetadataAndDocStringPass()(model)
    passes.NameFixPass()(model)


@contextmanager
def _almost_nothing_hidden(graph: ir.Graph) -> Iterator[None]:
    """Keep the values of constants near 0 and 1 from the rewriter.

    It drops summands and factors that are close to 0 and 1, not only those that are: without its
    1e-8 a norm is zero where its vector is, and what is divided by it is not a number.
    """
    hidden: list[tuple[ir.Value, ir.TensorProtocol]] = []
    for value in graph.initializers.values():
        tensor = constant(value)
        if tensor.size == 1 and tensor.dtype.is_floating_point():
            distance = min(abs(float(tensor.numpy().item()) - whole) for whole in (0, 1))
            if 0 < distance <= ALMOST:
                hidden.append((value, tensor))
    for value, _ in hidden:
        value.const_value = None
    try:
        yield
    finally:
        for value, tensor in hidden:
            value.const_value = tensor


def merge_constants(graph: ir.Graph, parameters: set[str]) -> None:
    """Keep one of each group of equal constants; parameters are never merged."""
    kept: dict[tuple[object, ...], ir.Value] = {}
    for name in [n for n in graph.initializers if n not in parameters]:
        value = graph.initializers[name]
        tensor = constant(value)
        twin = kept.setdefault((tensor.dtype, tuple(tensor.shape), tensor.tobytes()), value)
        if twin is not value and not value.is_graph_output():
            value.replace_all_uses_with(twin)
            graph.initializers.pop(name)


def name_axes(graph: ir.Graph) -> None:
    """Readable names for the dynamic axes, instead of what the tracer deduced about them."""
    for value in (*graph.inputs, *graph.outputs):
        names = AXES.get(str(value.name), ("views", "height", "width"))
        assert value.shape is not None
        value.shape = ir.Shape([*names, *value.shape.dims[len(names) :]])


def halve_weights(graph: ir.Graph, parameters: set[str]) -> None:
    """Store large weights in half precision, cast back to float32 where they are read."""
    for name in [n for n in graph.initializers if parameter_name(n) in parameters]:
        value = graph.initializers[name]
        tensor = constant(value)
        if not stored_in_half(tensor.size):
            continue
        widen = ir.node("Cast", [value], {"to": ir.DataType.FLOAT})
        wide = widen.outputs[0]
        wide.name, wide.shape, wide.dtype = name + WIDENED, value.shape, ir.DataType.FLOAT
        value.replace_all_uses_with(wide)
        widen.replace_input_with(0, value)
        graph.insert_before(graph[0], widen)
        _store(value, _halved(tensor, name))


def _halved(tensor: ir.TensorProtocol, name: str) -> ir.LazyTensor:
    return ir.LazyTensor(
        lambda: ir.Tensor(to_half(tensor.numpy(), name)),
        dtype=ir.DataType.FLOAT16,
        shape=sizes(tensor),
        name=name,
    )


def parameter_name(initializer: str) -> str:
    """The checkpoint's name of the parameter that an initializer holds."""
    return initializer.removesuffix(TRANSPOSED)
