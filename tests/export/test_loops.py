"""Iterations that run as they are written, and export as one loop."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx_ir as ir
import onnxruntime
import torch
from torch import Tensor, nn
from torch.export import Dim

from styl3r_export import graph_passes, onnx_export
from styl3r_export.model.loops import Carry, repeat

VALUES = (0.5, 0.25, 1.0, 0.125)


class Roots(nn.Module):
    """Damped Newton steps towards square roots, with a tensor from outside of the loop."""

    def forward(self, x: Tensor) -> Tensor:
        """Both carried tensors matter for the result."""

        def step(carry: Carry, damping: float | Tensor) -> Carry:
            root, moved = carry
            change = (x / root - root) / 2 * damping
            return root + change, moved + change.abs()

        root, moved = repeat(step, (x / 2, x * 0), VALUES)
        return torch.stack((root, moved))


def by_hand(x: np.ndarray) -> np.ndarray:
    root, moved = x / 2, np.zeros_like(x)
    for damping in VALUES:
        change = (x / root - root) / 2 * damping
        root, moved = root + change, moved + np.abs(change)
    return np.stack((root, moved))


def test_steps_are_applied_in_order() -> None:
    x = torch.rand(5, dtype=torch.float64) + 1
    np.testing.assert_allclose(Roots()(x), by_hand(x.numpy()), rtol=1e-14)


def test_gradients_flow_through_all_steps() -> None:
    x = (torch.rand(3, dtype=torch.float64) + 1).requires_grad_()
    assert torch.autograd.gradcheck(Roots(), (x,))


def test_no_values_leave_the_start() -> None:
    start = (torch.ones(2),)
    assert repeat(lambda carry, _: (carry[0] + 1,), start, ()) is start


def test_the_graph_holds_the_step_once(tmp_path: Path) -> None:
    dims = {"x": {0: Dim("n", min=2)}}
    graph_model = onnx_export.trace(Roots(), {"x": torch.rand(4) + 1}, dims, ["y"])
    graph_passes.simplify(graph_model, set())
    loops = [n for n in graph_model.graph if n.op_type == "Scan"]
    assert len(loops) == 1
    body = loops[0].attributes["body"].as_graph()
    assert sum(n.op_type == "Abs" for n in body) == 1
    assert not any(n.op_type == "Abs" for n in graph_model.graph)
    assert not body.initializers  # each of which would be one that no pass drops or merges
    ir.save(graph_model, tmp_path / "loop.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "loop.onnx")
    for size in (1, 3, 70):
        x = np.random.default_rng(size).random(size, np.float32) + 1
        np.testing.assert_allclose(session.run(None, {"x": x})[0], by_hand(x), rtol=1e-6)
