"""What several tests of exports need."""

from pathlib import Path

import pytest
import torch
from small_checkpoints import TINY
from small_network import PROVENANCE, UNSEEN, small_model

from styl3r_export import checkpoints, onnx_export
from styl3r_export.export_graphs import export_graphs
from styl3r_export.model import Styl3r, build


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> Styl3r:
    """A model of the published layout, small; loaders take its sizes for the published ones."""
    monkeypatch.setattr(checkpoints, "FULL", TINY)
    torch.manual_seed(0)
    return build(TINY)


@pytest.fixture(scope="session")
def halved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One fp16 export of the small network, verified with unseen sizes."""
    folder = tmp_path_factory.mktemp("export") / "fp16"
    report = export_graphs(small_model(), folder, "fp16", provenance=PROVENANCE, cases=UNSEEN)
    assert max(row.worst for row in report.rows) < 2e-5
    assert max(row.worst for row in report.losses) > 1e-5  # rounding is there, and is measured
    return folder


@pytest.fixture(scope="session")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One fp32 export with its weights in files of their own, as above 2 GB."""
    folder = tmp_path_factory.mktemp("export") / "fp32"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(onnx_export, "EXTERNAL_ABOVE", 1000)
        export_graphs(small_model(), folder, provenance=PROVENANCE, cases=())
    return folder
