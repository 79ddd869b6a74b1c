"""What happens to a traced graph: weights keep their names, and every pass keeps the numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx_ir as ir
import onnxruntime
import pytest
import torch
from torch import Tensor, nn
from torch.export import Dim

from styl3r_export import graph_passes, onnx_export
from styl3r_export.model.adapter import free_geometry
from styl3r_export.precision import HALF_MIN_ELEMENTS, rounded

NEARLY_ONE = 1 + 4e-6
WIDTH = 160  # squared it is large enough for half precision


class Inner(nn.Module):
    """Two equal norms, a large and a small matrix, and attention."""

    def __init__(self) -> None:
        super().__init__()
        self.norm1, self.norm2 = nn.LayerNorm(WIDTH), nn.LayerNorm(WIDTH)
        self.large = nn.Linear(WIDTH, WIDTH)
        self.small = nn.Linear(WIDTH, 3)
        self.unused = nn.Linear(2, 2)

    def forward(self, x: Tensor) -> Tensor:
        """Compute."""
        y = self.large(self.norm1(x)).unflatten(-1, (2, -1)).transpose(-3, -2)
        y = nn.functional.scaled_dot_product_attention(y, y + 1, y * 2)
        return self.small(self.norm2(y.transpose(-3, -2).flatten(-2)) + torch.arange(2).sum())


class Wrapper(nn.Module):
    """As the exporter wraps a model."""

    def __init__(self, model: nn.Module) -> None:
        super().__init__()
        self.model = model

    def forward(self, x: Tensor) -> Tensor:
        """Compute."""
        return self.model(x)


@pytest.fixture(scope="module")
def model() -> Inner:
    torch.manual_seed(0)
    return Inner().eval()


@pytest.fixture(scope="module")
def traced(model: Inner, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The unsimplified graph, from which every test starts."""
    path = tmp_path_factory.mktemp("traced") / "graph.onnx"
    dims = {"x": {0: Dim("n", min=2), 1: Dim("length", min=2)}}
    ir.save(onnx_export.trace(Wrapper(model), {"x": torch.rand(3, 5, WIDTH)}, dims, ["y"]), path)
    return path


def run(graph_model: ir.Model, folder: Path, x: Tensor) -> np.ndarray:
    path = folder / "run.onnx"
    ir.save(graph_model, path)
    return onnxruntime.InferenceSession(path).run(None, {"x": x.numpy()})[0]


def finished(traced: Path, model: Inner, halve: bool) -> ir.Model:
    graph_model = ir.load(traced)
    parameters = {n for n, _ in model.named_parameters()}
    graph_passes.name_weights(graph_model.graph)
    graph_passes.fold_transposes(graph_model.graph)
    graph_passes.simplify(graph_model, parameters | {f"{n}.T" for n in parameters})
    if halve:
        graph_passes.halve_weights(graph_model.graph, parameters)
    return graph_model


def test_every_used_parameter_keeps_its_name_and_values(traced: Path, model: Inner) -> None:
    graph = finished(traced, model, halve=False).graph
    for name, parameter in model.named_parameters():
        if name.startswith("unused"):
            assert name not in graph.initializers
            continue
        turned = name.endswith("weight") and parameter.dim() == 2
        value = graph.initializers[f"{name}.T" if turned else name].const_value
        assert value is not None
        assert np.array_equal(value.numpy().T if turned else value.numpy(), parameter.detach())


def test_no_matrix_is_turned_at_run_time(traced: Path, model: Inner) -> None:
    graph = finished(traced, model, halve=False).graph
    turned = [n for n in graph if n.op_type == "Transpose"]
    assert all(not node.inputs[0].is_initializer() for node in turned)


@pytest.mark.parametrize("size", [(2, 2), (3, 7), (1, 1)])
def test_a_simplified_graph_gives_the_same_numbers(
    traced: Path, model: Inner, tmp_path: Path, size: tuple[int, int]
) -> None:
    x = torch.randn(*size, WIDTH)
    with torch.no_grad():
        expected = model(x)
    out = run(finished(traced, model, halve=False), tmp_path, x)
    np.testing.assert_allclose(out, expected, atol=2e-6)


def test_simplifying_leaves_few_operators(traced: Path, model: Inner) -> None:
    before, after = ir.load(traced).graph, finished(traced, model, halve=False).graph
    assert len(after) < len(before)
    kinds = {n.op_type for n in after}
    assert not kinds & {"CastLike", "SequenceAt", "SplitToSequence", "Identity", "Constant"}
    assert sum(n.op_type == "Softmax" for n in after) == 1


class Activations(nn.Module):
    """The published ones, a factor that is almost one, and what does nothing."""

    def forward(self, points: Tensor, structure: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Rotations, means, and points that are a little larger."""
        geometry = free_geometry(points, structure)
        return geometry.rotations, geometry.means, (points + 0) * 1 * NEARLY_ONE


def test_small_summands_and_factors_near_one_stay(tmp_path: Path) -> None:
    """A zero quaternion is divided by its norm plus 1e-8: zero, and not a number without it."""
    module = Activations()
    inputs = {"points": torch.randn(1, 3, 3, 4, 5), "structure": torch.randn(1, 3, 8, 4, 5)}
    inputs["points"][..., 0], inputs["structure"][..., 0] = 0, 0
    graph_model = onnx_export.trace(module, inputs, {}, ["rotations", "means", "larger"])
    graph_passes.simplify(graph_model, set())
    ir.save(graph_model, tmp_path / "run.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "run.onnx")
    given = session.run(None, {name: value.numpy() for name, value in inputs.items()})
    for values, expected in zip(given, module(**inputs), strict=True):
        assert np.isfinite(values).all()
        np.testing.assert_allclose(values, expected, rtol=1e-6, atol=1e-7)
    assert (given[0][..., 0, :] == 0).all()
    kinds = [node.op_type for node in graph_model.graph]
    assert kinds.count("Mul") <= 3  # none is by 1, and none of the sums is with 0
    assert kinds.count("Add") == 1


def test_half_precision_is_storage_only(traced: Path, model: Inner, tmp_path: Path) -> None:
    graph_model = finished(traced, model, halve=True)
    types = {n: v.dtype for n, v in graph_model.graph.initializers.items()}
    assert types["large.weight.T"] == ir.DataType.FLOAT16
    assert types["small.weight.T"] == types["norm1.weight"] == ir.DataType.FLOAT
    assert WIDTH * 3 < HALF_MIN_ELEMENTS <= WIDTH * WIDTH
    x = torch.randn(2, 3, WIDTH)
    out = run(graph_model, tmp_path, x)
    with torch.no_grad():
        exact = model(x)
        copy = Inner()
        copy.load_state_dict(model.state_dict())
        copy.large.weight.copy_(rounded(copy.large.weight))
        expected = copy(x)
    np.testing.assert_allclose(out, expected, atol=2e-6)
    assert np.abs(out - exact.numpy()).max() > 1e-5


def test_equal_constants_become_one_and_equal_parameters_stay_two() -> None:
    x = ir.val("x", ir.DataType.FLOAT, [2])
    values = {n: ir.tensor(np.float32([1, 2])) for n in ("a", "b", "gain1", "gain2")}
    initializers = {n: ir.Value(name=n, const_value=t) for n, t in values.items()}
    nodes, last = [], x
    for value in initializers.values():
        node = ir.node("Add", [last, value])
        nodes.append(node)
        last = node.outputs[0]
    graph = ir.Graph([x], [last], nodes=nodes, initializers=[*initializers.values()])
    graph_passes.merge_constants(graph, {"gain1", "gain2"})
    assert set(graph.initializers) == {"a", "gain1", "gain2"}
    assert [n.inputs[1].name for n in graph] == ["a", "a", "gain1", "gain2"]
