"""How weights are stored: half precision, 8 or 16-bit integers, widened to float32 where read."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import onnx
from onnx import helper, numpy_helper

from styl3r_cli.errors import ModelError

# Tensors below this size stay float32: biases, norms, the heads' last convolutions, the camera
# token. They are sensitive, and together less than 2 % of the weights.
HALF_MIN_ELEMENTS = 16384
HALF_MAX = float(np.finfo(np.float16).max)
LARGEST_INT8 = 127  # symmetric: -128 is not used
LARGEST_INT16 = 32767
# What a widened weight is called: under the stored one's name, with this at its end.
WIDENED = "/float32"
MICROSOFT = "com.microsoft"  # its DequantizeLinear reads 16 bits in every operator set
SCALE, INTEGERS = "/scale", "/integers"


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


def widen(graph: onnx.GraphProto) -> None:
    """Store half precision weights as the float32 values that the graph computes with, in place."""
    stored = {tensor.name: tensor for tensor in graph.initializer}
    for node in [n for n in graph.node if n.op_type == "Cast" and n.input[0] in stored]:
        tensor, wide = stored[node.input[0]], node.output[0]
        if tensor.data_type != onnx.TensorProto.FLOAT16 or not wide.endswith(WIDENED):
            continue
        values = numpy_helper.to_array(tensor).astype(np.float32)
        tensor.CopyFrom(numpy_helper.from_array(values, tensor.name))
        _rename_uses(graph, wide, tensor.name)
        graph.node.remove(node)
    known = [value for value in graph.value_info if value.name not in stored]
    del graph.value_info[:]  # what was said of the stored weights' types is no longer so
    graph.value_info.extend(known)


def _rename_uses(graph: onnx.GraphProto, old: str, new: str) -> None:
    """Let every node read another value, the bodies of loops included."""
    for node in graph.node:
        for index, name in enumerate(node.input):
            if name == old:
                node.input[index] = new
        for attribute in node.attribute:
            if attribute.type == onnx.AttributeProto.GRAPH:
                _rename_uses(attribute.g, old, new)


def halve(graph: onnx.GraphProto, names: set[str]) -> None:
    """Store weights in half precision, cast to float32 where they are read, in place."""
    for tensor in _named(graph, names):
        half = to_half(numpy_helper.to_array(tensor), tensor.name)
        _replace(graph, tensor, [numpy_helper.from_array(half, tensor.name)], _casts(tensor.name))


def store_as_integers(graph: onnx.GraphProto, names: set[str]) -> None:
    """Store weights as 8-bit integers and a scale an output channel, in place.

    They are turned into float32 by a Cast and a Mul, which runtimes fold when they load a graph:
    computation, and what a runtime makes of constant weights, stay as they are.
    """
    columns = columns_out(graph)
    for tensor in _named(graph, names):
        values = numpy_helper.to_array(tensor)
        axis = values.ndim - 1 if tensor.name in columns else 0
        integers, scales = to_int8(values, axis)
        stored = tensor.name + INTEGERS
        parts = [
            numpy_helper.from_array(integers, stored),
            numpy_helper.from_array(scales, tensor.name + SCALE),
        ]
        wide = tensor.name + WIDENED
        nodes = [
            helper.make_node("Cast", [stored], [f"{stored}{WIDENED}"], to=onnx.TensorProto.FLOAT),
            helper.make_node("Mul", [f"{stored}{WIDENED}", tensor.name + SCALE], [wide]),
        ]
        _replace(graph, tensor, parts, nodes)


def store_as_long_integers(model: onnx.ModelProto, names: set[str]) -> None:
    """Store matrices as 16-bit integers and a scale an input channel, in place.

    Ten times as exact as half precision where a row's values are of one size. DequantizeLinear is
    what onnxruntime does not compute beforehand: a matrix is widened when it is used, for a tenth
    of the product's time, and takes half the memory of float32.
    """
    for tensor in _named(model.graph, names):
        values = numpy_helper.to_array(tensor)
        integers, scales = to_integers(values, 0, LARGEST_INT16)
        stored, scale = tensor.name + INTEGERS, tensor.name + SCALE
        parts = [
            numpy_helper.from_array(integers.astype(np.int16), stored),
            numpy_helper.from_array(scales.reshape(-1), scale),
        ]
        node = helper.make_node(
            "DequantizeLinear", [stored, scale], [tensor.name + WIDENED], axis=0, domain=MICROSOFT
        )
        _replace(model.graph, tensor, parts, [node])
    if all(known.domain != MICROSOFT for known in model.opset_import):
        model.opset_import.append(helper.make_opsetid(MICROSOFT, 1))


def columns_out(graph: onnx.GraphProto) -> set[str]:
    """Weights of matrix products: their last axis is the output's, of convolutions it is the first.

    (A transposed convolution's second axis is; scaled along its first it is as exact.)
    """
    return {n.input[1] for n in graph.node if n.op_type == "MatMul"}


def to_int8(
    values: npt.NDArray[np.float32], axis: int
) -> tuple[npt.NDArray[np.int8], npt.NDArray[np.float32]]:
    """8-bit integers and their scale along an axis, which has the same number of dimensions."""
    integers, scales = to_integers(values, axis, LARGEST_INT8)
    return integers.astype(np.int8), scales


def to_integers(
    values: npt.NDArray[np.float32], axis: int, largest_integer: int
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Whole numbers up to a largest one, and their scale along an axis."""
    others = tuple(i for i in range(values.ndim) if i != axis)
    largest = np.abs(values).max(axis=others, keepdims=True)
    scales = np.where(largest > 0, largest / largest_integer, 1).astype(np.float32)
    return np.rint(values / scales), scales


def _named(graph: onnx.GraphProto, names: set[str]) -> Iterator[onnx.TensorProto]:
    yield from [tensor for tensor in graph.initializer if tensor.name in names]


def _casts(name: str) -> list[onnx.NodeProto]:
    return [helper.make_node("Cast", [name], [name + WIDENED], to=onnx.TensorProto.FLOAT)]


def _replace(
    graph: onnx.GraphProto,
    tensor: onnx.TensorProto,
    parts: list[onnx.TensorProto],
    nodes: list[onnx.NodeProto],
) -> None:
    """A weight's stored parts, and the nodes that widen them, in its place."""
    _rename_uses(graph, tensor.name, tensor.name + WIDENED)
    graph.initializer.remove(tensor)
    graph.initializer.extend(parts)
    for node in reversed(nodes):
        graph.node.insert(0, node)
