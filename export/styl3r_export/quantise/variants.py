"""The precisions that graphs come in, and which of a graph's weights each of them touches."""

from __future__ import annotations

from dataclasses import dataclass

import onnx

from styl3r_export.quantise.storage import HALF_MIN_ELEMENTS

HEAD = "head"  # in the names of the dense heads' convolutions, of both network sizes
# In those of the heads for opacities, scales and rotations. Those for points are not among them:
# an error of 1 % in them moves a Gaussian by pixels, in the others it changes its look by 1 %.
LOOK_HEAD = "gaussian_param_head"


@dataclass(frozen=True)
class Variant:
    """One precision.

    Attributes:
        name: as `--precision` takes it.
        told: what it is, for --help.
        calibrated: whether it needs photos to learn the range of values from.
    """

    name: str
    told: str
    calibrated: bool = False


VARIANTS = {
    variant.name: variant
    for variant in (
        Variant("fp32", "float32"),
        Variant("fp16", "weights in half precision, computed in float32"),
        Variant("w8", "weights in 8 bits, computed in float32"),
        Variant("w4", "matrices in 4 bits, convolutions in 8, computed in float32"),
        Variant("int8", "matrix products in 8-bit integers, ranges found as it runs"),
        Variant("int8-static", "int8, and the heads' convolutions too", calibrated=True),
        Variant("mixed", "points in float32, all else as int8-static", calibrated=True),
    )
}


@dataclass(frozen=True)
class Large:
    """A graph's large weights, by how they are used; all others stay float32.

    Attributes:
        matrices: names of the nodes that multiply with a constant matrix.
        head_convolutions: names of the dense heads' convolutions.
        look_convolutions: those among them that decide on looks, not on places.
        multiplied: the weights that those products read.
        convolved: the weights that convolutions read, the heads' and all others.
        rest: all other large weights, those that loops read among them.
    """

    matrices: list[str]
    head_convolutions: list[str]
    look_convolutions: list[str]
    multiplied: set[str]
    convolved: set[str]
    rest: set[str]

    @property
    def weights(self) -> set[str]:
        """All large weights."""
        return self.multiplied | self.convolved | self.rest


def find_large(graph: onnx.GraphProto) -> Large:
    """The weights that lower precisions may touch.

    Normalisation, softmax, the exponential of depths, every activation at the end of a head and
    every small weight are not among them.
    """
    large = {
        tensor.name
        for tensor in graph.initializer
        if tensor.data_type == onnx.TensorProto.FLOAT and _elements(tensor) >= HALF_MIN_ELEMENTS
    }
    products = [n for n in graph.node if n.op_type == "MatMul" and n.input[1] in large]
    convolutions = [
        n for n in graph.node if n.op_type in ("Conv", "ConvTranspose") and n.input[1] in large
    ]
    heads = [n for n in convolutions if n.op_type == "Conv" and HEAD in n.input[1]]
    looks = [n.name for n in heads if LOOK_HEAD in n.input[1]]
    convolved = {n.input[1] for n in convolutions}
    multiplied = {n.input[1] for n in products}
    rest = large - multiplied - convolved
    matrices, head_names = ([n.name for n in nodes] for nodes in (products, heads))
    return Large(matrices, head_names, looks, multiplied, convolved, rest)


def _elements(tensor: onnx.TensorProto) -> int:
    count = 1
    for size in tensor.dims:
        count *= size
    return count
