"""Written graphs against the torch model they came from, over views, styles and sizes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from styl3r_cli.manifest import APPEARANCE, STRUCTURE
from styl3r_cli.onnx_library import onnxruntime
from styl3r_export.model.config import PATCH
from styl3r_export.model.network import Styl3r
from styl3r_export.precision import rounded, stored_in_half

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

Arrays = dict[str, npt.NDArray[np.float32]]

# Largest relative error (of either kind, see `Row`) that a graph may have.
TOLERANCE = 1e-3
SEED = 1
# Random values along a test picture's side, coarse and fine; what lies between is interpolated.
NODES, FINE_NODES = 4, 24
# Each view is a window of this share of one picture: views that show nothing in common have no
# cameras, and what a solver then gives hangs on the last bit.
WINDOW = 0.8


@dataclass(frozen=True)
class Case:
    """One set of inputs: how many views and styles, and their sizes."""

    views: int
    styles: int
    size: tuple[int, int]
    style_size: tuple[int, int]

    def __str__(self) -> str:
        height, width = self.size
        return f"{self.views} views {height}x{width}, {self.styles} style{'s'[: self.styles - 1]}"


SQUARE = (16 * PATCH, 16 * PATCH)
# Odd patch counts both ways: grids that do not halve evenly take a path of their own.
ODD, ODD_STYLE = (7 * PATCH, 11 * PATCH), (8 * PATCH, 6 * PATCH)
CASES = tuple(
    case
    for views in (2, 3, 4, 8)
    for case in (Case(views, 1, SQUARE, SQUARE), Case(views, 3, ODD, ODD_STYLE))
)


@dataclass(frozen=True)
class Row:
    """How far one output of one case is off.

    Attributes:
        case: the inputs.
        output: the output's name.
        max_abs: largest absolute difference.
        max_rel: the same over the largest absolute value that torch gives.
        rms_rel: root mean square of the difference over that of torch's values.
    """

    case: Case
    output: str
    max_abs: float
    max_rel: float
    rms_rel: float

    @property
    def worst(self) -> float:
        """The larger of the two relative errors; NaN counts as infinite."""
        worst = max(self.max_rel, self.rms_rel)
        return worst if worst == worst else float("inf")


def expected(model: Styl3r, cases: tuple[Case, ...] = CASES) -> list[tuple[Arrays, Arrays]]:
    """Inputs of both graphs, and the outputs that torch computes from them, for each case."""
    return [_expected(model, case) for case in cases]


@torch.no_grad()
def _expected(model: Styl3r, case: Case) -> tuple[Arrays, Arrays]:
    inputs = make_inputs(case)
    structure = model.structure(inputs["images"], inputs["intrinsics"])
    inputs["content_tokens"] = structure.content_tokens
    colours = model.appearance(
        structure.content_tokens, inputs["style_images"], inputs["style_weights"], inputs["images"]
    )
    outputs = structure._asdict() | {"colours": colours}
    return {k: v.numpy() for k, v in inputs.items()}, {k: v.numpy() for k, v in outputs.items()}


def make_inputs(case: Case) -> dict[str, Tensor]:
    """Overlapping views of a random picture, cameras that differ, weights that sum to one."""
    random = torch.Generator().manual_seed(SEED)

    def pictures(count: int, size: tuple[int, int]) -> Tensor:
        layers = (torch.rand(count, 3, n, n, generator=random) for n in (NODES, FINE_NODES))
        coarse, fine = (F.interpolate(layer, size, mode="bilinear") for layer in layers)
        return (coarse + fine) / 2

    def views(count: int, size: tuple[int, int]) -> Tensor:
        height, width = size
        whole = pictures(1, (round(height / WINDOW), round(width / WINDOW)))
        spare = (whole.shape[-2] - height, whole.shape[-1] - width)
        corners = [[view * s // max(count - 1, 1) for s in spare] for view in range(count)]
        return torch.cat([whole[..., y : y + height, x : x + width] for y, x in corners])

    intrinsics = torch.zeros(case.views, 3, 3)
    intrinsics[:, 0, 0] = 0.7 + 0.3 * torch.rand(case.views, generator=random)
    intrinsics[:, 1, 1] = intrinsics[:, 0, 0] * case.size[1] / case.size[0]
    intrinsics[:, :2, 2] = 0.48 + 0.04 * torch.rand(case.views, 2, generator=random)
    intrinsics[:, 2, 2] = 1
    styles = pictures(case.styles, case.style_size)
    styles[1:] = styles[1:] * 2 - 1  # as photos that stand in for a style are fed
    weights = torch.rand(case.styles, generator=random) + 0.5
    return {
        "images": views(case.views, case.size),
        "intrinsics": intrinsics,
        "style_images": styles,
        "style_weights": weights / weights.sum(),
    }


def compare(
    folder: Path, references: list[tuple[Arrays, Arrays]], cases: tuple[Case, ...] = CASES
) -> list[Row]:
    """Run both graphs, one after the other, on the inputs that torch had."""
    rows = []
    for graph in (STRUCTURE, APPEARANCE):
        session = open_session(folder / graph)
        for case, (inputs, outputs) in zip(cases, references, strict=True):
            fed = {i.name: inputs[i.name] for i in session.get_inputs()}
            names = [o.name for o in session.get_outputs()]
            for name, value in zip(names, session.run(names, fed), strict=True):
                rows.append(measure(case, name, value, outputs[name]))
        del session  # a full model's graphs do not fit beside each other everywhere
    return sorted(rows, key=lambda row: cases.index(row.case))


def open_session(path: Path) -> InferenceSession:
    """A graph on the CPU, without a memory arena that would outlive a run's peak."""
    ort = onnxruntime()
    options = ort.SessionOptions()
    options.enable_cpu_mem_arena = False
    options.log_severity_level = 3  # errors
    session: InferenceSession = ort.InferenceSession(
        path, options, providers=["CPUExecutionProvider"]
    )
    return session


def measure(
    case: Case, name: str, value: npt.NDArray[np.float32], truth: npt.NDArray[np.float32]
) -> Row:
    """How far an output is from torch's."""
    if value.shape != truth.shape:
        return Row(case, name, *3 * (float("inf"),))
    difference = value.astype(np.float64) - truth
    largest, size = float(np.abs(difference).max()), float(np.abs(truth).max())
    rms = float(np.sqrt(np.square(difference).mean()))
    norm = float(np.sqrt(np.square(truth.astype(np.float64)).mean()))
    tiny = float(np.finfo(np.float32).tiny)
    return Row(case, name, largest, largest / max(size, tiny), rms / max(norm, tiny))


@contextmanager
def weights_as_stored(model: nn.Module) -> Iterator[None]:
    """Inside the block, the model has the weights that a half precision graph stores."""
    parameters = [p for p in model.parameters() if stored_in_half(p.numel())]
    originals = [p.data for p in parameters]
    try:
        for parameter in parameters:
            parameter.data = rounded(parameter.data)
        yield
    finally:
        for parameter, original in zip(parameters, originals, strict=True):
            parameter.data = original


def worst_of_each_output(rows: list[Row]) -> list[Row]:
    """For each output the row with the largest relative error."""
    names = dict.fromkeys(row.output for row in rows)
    return [max((r for r in rows if r.output == n), key=lambda r: r.worst) for n in names]


def table(rows: list[Row]) -> str:
    """The rows, as text columns."""
    lines = [f"{'case':30}{'output':16}{'max abs':>10}{'max rel':>10}{'rms rel':>10}"]
    lines += [
        f"{r.case!s:30}{r.output:16}{r.max_abs:10.1e}{r.max_rel:10.1e}{r.rms_rel:10.1e}"
        for r in rows
    ]
    return "\n".join(lines)
