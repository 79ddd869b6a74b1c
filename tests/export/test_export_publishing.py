"""An export appears whole or not at all, and never in place of something else."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import torch
from small_network import SMALL, UNSEEN, small_model

from styl3r_cli import manifest as manifests
from styl3r_cli.errors import ModelError, OutputError
from styl3r_export import export_graphs as exporting
from styl3r_export.export_graphs import check_finite, export_graphs
from styl3r_export.graphs_reading import load_graphs
from styl3r_export.model import Styl3r, build
from styl3r_export.quantise.folders import check_target


@pytest.mark.slow
def test_a_graph_that_differs_is_not_published(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, halved: Path
) -> None:
    """The graphs of another model, as if the exporter had gone wrong."""
    folder = tmp_path / "new"

    def write(model: Styl3r, target: Path, *_: object) -> manifests.Manifest:
        for path in halved.iterdir():
            (target / path.name).write_bytes(path.read_bytes())
        return manifests.read_manifest(target)

    monkeypatch.setattr(exporting, "write_graphs", write)
    torch.manual_seed(99)
    with pytest.raises(ModelError, match=r"relative error .* nothing written"):
        export_graphs(build(SMALL), folder, cases=UNSEEN[:1])
    assert list(tmp_path.iterdir()) == []


def write_earlier(folder: Path) -> str:
    """A folder as an earlier export left it; returns its manifest."""
    folder.mkdir()
    for name in (manifests.STRUCTURE, manifests.APPEARANCE, "structure.onnx.data"):
        (folder / name).write_text("of the earlier export")
    earlier = manifests.Manifest("mini", "0", "abc", "fp32", manifests.describe_files(folder))
    (folder / manifests.MANIFEST).write_text(earlier.to_json())
    return earlier.to_json()


def test_an_interrupted_export_leaves_nothing_and_keeps_the_earlier_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "model"
    earlier = write_earlier(folder)

    def write(_: Styl3r, target: Path, *__: object) -> manifests.Manifest:
        (target / "half").write_text("written")
        raise KeyboardInterrupt

    monkeypatch.setattr(exporting, "write_graphs", write)
    with pytest.raises(KeyboardInterrupt):
        export_graphs(small_model(), folder, cases=())
    assert [p.name for p in tmp_path.iterdir()] == ["model"]
    assert (folder / manifests.MANIFEST).read_text() == earlier


@pytest.mark.slow
def test_an_earlier_export_is_replaced_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, halved: Path
) -> None:
    folder = tmp_path / "model"
    write_earlier(folder)

    def write(_: Styl3r, target: Path, *__: object) -> manifests.Manifest:
        (target / "new").write_text("new")
        return manifests.read_manifest(halved)

    monkeypatch.setattr(exporting, "write_graphs", write)
    export_graphs(small_model(), folder, cases=())
    assert [p.name for p in folder.iterdir()] == ["new"]
    assert [p.name for p in tmp_path.iterdir()] == ["model"]


def test_folders_in_use_are_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    for folder, message in (
        (tmp_path, "holds something else"),
        (tmp_path / "file", "it is a file"),
        (tmp_path / "none" / "model", "does not exist"),
    ):
        with pytest.raises(OutputError, match=message):
            check_target(folder)
    check_target(tmp_path / "new")
    page = tmp_path / "page"  # web pages have a manifest.json, too; and all in a folder would go
    page.mkdir()
    (page / manifests.MANIFEST).write_text('{"name": "a page"}')
    with pytest.raises(OutputError, match="holds something else"):
        check_target(page)


def test_a_folder_that_also_holds_something_else_is_refused(halved: Path, tmp_path: Path) -> None:
    folder = tmp_path / "model"
    shutil.copytree(halved, folder)
    check_target(folder)
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"holds something else \(notes.txt\)"):
        check_target(folder)


def test_empty_folders_are_taken(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    check_target(tmp_path / "empty")


@pytest.mark.slow
def test_graphs_that_were_exchanged_are_refused(halved: Path, tmp_path: Path) -> None:
    for path in halved.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    path = tmp_path / manifests.MANIFEST
    path.write_text(path.read_text().replace(manifests.read_manifest(halved).weights_id, "other"))
    with pytest.raises(ModelError, match="do not belong together"):
        load_graphs(tmp_path)


def test_a_broken_training_is_noticed() -> None:
    model = small_model()
    check_finite(model)
    with torch.no_grad():
        model.get_parameter("backbone.enc_norm.weight")[0] = float("nan")
    with pytest.raises(ModelError, match=r"backbone\.enc_norm\.weight"):
        check_finite(model)
