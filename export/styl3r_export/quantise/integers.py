"""Matrix products and convolutions in few bits: onnxruntime's quantisers, on chosen nodes only."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import onnx

from styl3r_cli.gaussians import FloatArray
from styl3r_cli.onnx_library import onnxruntime

Feeds = dict[str, FloatArray]

BLOCK = 32  # weights that share a 4-bit scale: the smallest block that every kernel has
FLOAT32_ACTIVATIONS = 1  # MatMulNBits' accuracy level: weights are widened, sums are float32


def pack_matrices(model: onnx.ModelProto, nodes: Sequence[str]) -> onnx.ModelProto:
    """Matrices in 4 bits (MatMulNBits)."""
    nbits = onnxruntime("quantization.matmul_nbits_quantizer")
    config = nbits.DefaultWeightOnlyQuantConfig(
        block_size=BLOCK, is_symmetric=False, accuracy_level=FLOAT32_ACTIVATIONS, bits=4
    )
    every = [n.name for n in model.graph.node if n.op_type in ("MatMul", "Gather")]
    left_out = sorted(set(every) - set(nodes))
    quantiser = nbits.MatMulNBitsQuantizer(model, nodes_to_exclude=left_out, algo_config=config)
    with _quiet():
        quantiser.process()
    packed: onnx.ModelProto = quantiser.model.model
    return packed


def multiply_integers(source: Path, nodes: Sequence[str], target: Path) -> None:
    """Matrix products in 8 bits: weights a scale a column, activations as they come.

    Args:
        source: a graph with float32 weights, inside it or beside it. A graph in memory would be
            copied twice, and one of over 2 GB would not fit a protobuf message.
        nodes: the products' names.
        target: where the result is written.
    """
    quantization = onnxruntime("quantization")
    with _quiet():
        quantization.quantize_dynamic(
            source,
            target,
            op_types_to_quantize=["MatMul"],
            per_channel=True,
            weight_type=quantization.QuantType.QInt8,
            nodes_to_quantize=list(nodes),
        )


def calibrate_convolutions(
    model: onnx.ModelProto, nodes: Sequence[str], feeds: Sequence[Feeds], path: Path
) -> None:
    """Convolutions in 8 bits, between values whose range was seen on calibration photos.

    Args:
        model: with float32 weights.
        nodes: the convolutions' names.
        feeds: the graph's inputs, one for each group of photos.
        path: where the result is written.
    """
    quantization = onnxruntime("quantization")
    _own_inputs(model.graph, set(nodes))
    with _quiet():
        quantization.quantize_static(
            model,
            path,
            _Reader(feeds),
            quant_format=quantization.QuantFormat.QDQ,
            op_types_to_quantize=["Conv"],
            per_channel=True,
            activation_type=quantization.QuantType.QUInt8,
            weight_type=quantization.QuantType.QInt8,
            nodes_to_quantize=list(nodes),
        )


def _own_inputs(graph: onnx.GraphProto, names: set[str]) -> None:
    """Give the chosen convolutions inputs that no other node reads, in place.

    The quantiser rounds a value for all who read it: what stays float32 would read it rounded too.
    """
    chosen = [node for node in graph.node if node.name in names]
    shared = {i for node in graph.node if node.name not in names for i in node.input}
    for source in sorted({node.input[0] for node in chosen} & shared):
        own = f"{source}/own"
        readers = [node for node in chosen if node.input[0] == source]
        for node in readers:
            node.input[0] = own
        first = min(list(graph.node).index(node) for node in readers)
        graph.node.insert(first, onnx.helper.make_node("Identity", [source], [own]))


class _Reader:
    """Calibration inputs, one set after the other, as onnxruntime asks for them."""

    def __init__(self, feeds: Sequence[Feeds]) -> None:
        self._rest: Iterator[Feeds] = iter(feeds)

    def get_next(self) -> dict[str, np.ndarray] | None:
        """The next inputs; None after the last."""
        return next(self._rest, None)

    def set_range(self, start_index: int, end_index: int) -> None:
        """Not used by calibrations that see everything at once."""


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the quantisers' advice, which is for other kinds of graphs, off the terminal."""
    root = logging.getLogger()
    level = root.level
    root.setLevel(logging.ERROR)
    try:
        yield
    finally:
        root.setLevel(level)
