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


def multiply_integers(model: onnx.ModelProto, nodes: Sequence[str], path: Path) -> None:
    """Matrix products in 8 bits: weights a scale a column, activations as they come.

    Args:
        model: with float32 weights.
        nodes: the products' names.
        path: where the result is written.
    """
    quantization = onnxruntime("quantization")
    with _quiet():
        quantization.quantize_dynamic(
            model,
            path,
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
