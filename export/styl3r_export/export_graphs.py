"""A model into a folder of verified graphs, all or nothing."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import torch

from styl3r_cli.errors import ModelError
from styl3r_cli.manifest import Manifest
from styl3r_export.graphs_metadata import OWN_LICENCE, Provenance
from styl3r_export.model.network import Styl3r
from styl3r_export.onnx_export import Precision, write_graphs
from styl3r_export.quantise.folders import replacing
from styl3r_export.verify import (
    CASES,
    TOLERANCE,
    Arrays,
    Case,
    Row,
    compare,
    expected,
    measure,
    weights_as_stored,
)

# Entered with a name; the command's console shows how long it takes.
Stage = Callable[[str], AbstractContextManager[object]]

UNNAMED = Provenance("unversioned", OWN_LICENCE)


@dataclass(frozen=True)
class ExportReport:
    """What was written, and how exact it is.

    Attributes:
        manifest: the written files.
        rows: onnxruntime against torch with the weights that the graphs store.
        losses: torch with the weights that the graphs store against the model as it was; empty
            unless weights were rounded.
    """

    manifest: Manifest
    rows: list[Row]
    losses: list[Row]


def export_graphs(
    model: Styl3r,
    folder: Path,
    precision: Precision = "fp32",
    *,
    provenance: Provenance = UNNAMED,
    cases: tuple[Case, ...] = CASES,
    stage: Stage = nullcontext,
) -> ExportReport:
    """Write `structure.onnx`, `appearance.onnx` and `manifest.json`, and make sure they are right.

    Args:
        model: in eval mode, float32, on the CPU.
        folder: a new folder, an empty one, or an earlier export, which is replaced.
        precision: how weights are stored; edges and computation are float32 either way.
        provenance: where the weights came from.
        cases: inputs to verify with; none to skip verification.
        stage: is entered with a name around each part of the work.

    Raises:
        OutputError: the folder is in use by something else, or cannot be written.
        ModelError: a graph differs from the model by more than `TOLERANCE`; nothing is written.
    """
    with replacing(folder) as temporary:
        with stage("tracing and writing"):
            manifest = write_graphs(model, temporary, provenance, precision)
        rows, losses = _verify(model, temporary, precision, cases, stage)
    return ExportReport(manifest, rows, losses)


def _verify(
    model: Styl3r,
    folder: Path,
    precision: Precision,
    cases: tuple[Case, ...],
    stage: Stage,
) -> tuple[list[Row], list[Row]]:
    if not cases:
        return [], []
    rounds = precision == "fp16"
    with stage("running torch"), weights_as_stored(model) if rounds else nullcontext():
        references = expected(model, cases)
    with stage("running onnxruntime"):
        rows = compare(folder, references, cases)
    worst = max(rows, key=lambda row: row.worst)
    if not worst.worst <= TOLERANCE:
        message = f"the graphs differ from the model: {worst.output}, {worst.case}"
        raise ModelError(
            f"{message}: relative error {worst.worst:.1e}, more than {TOLERANCE:g}; nothing written"
        )
    if not rounds:
        return rows, []
    with stage("running torch with exact weights"):
        return rows, _losses(references, expected(model, cases), cases)


def _losses(
    rounded: list[tuple[Arrays, Arrays]],
    exact: list[tuple[Arrays, Arrays]],
    cases: tuple[Case, ...],
) -> list[Row]:
    return [
        measure(case, name, value, truth[name])
        for case, (_, values), (_, truth) in zip(cases, rounded, exact, strict=True)
        for name, value in values.items()
    ]


def check_finite(model: Styl3r) -> None:
    """Make sure that a model's weights are finite numbers.

    Raises:
        ModelError: they are not; its training went wrong.
    """
    broken = [n for n, p in model.named_parameters() if not bool(torch.isfinite(p).all())]
    if broken:
        raise ModelError(f"the checkpoint's {broken[0]} is not finite; its training went wrong")
