"""Exported graphs: the contract, the same numbers as torch, and nothing half-written."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from styl3r_cli import manifest as manifests
from styl3r_cli.errors import ExitCode, ModelError, OutputError
from styl3r_cli.graphs import BUNDLED
from styl3r_cli.main import run
from styl3r_export import export_graphs as exporting
from styl3r_export import onnx_export
from styl3r_export.export_graphs import check_finite, export_graphs
from styl3r_export.graphs_metadata import Provenance
from styl3r_export.graphs_reading import is_needed, load_graphs
from styl3r_export.model import FULL, ModelConfig, Styl3r, build
from styl3r_export.precision import HALF_MIN_ELEMENTS, round_weights, rounded, to_half
from styl3r_export.quantise.folders import check_target
from styl3r_export.verify import (
    CASES,
    Case,
    compare,
    expected,
    measure,
    open_session,
    table,
    weights_as_stored,
    worst_of_each_output,
)

# The published network, small, with a few weights that are large enough to be halved.
SMALL = replace(
    FULL,
    head_dim=32,
    encoder_dim=96,
    encoder_depth=1,
    style_depth=1,
    decoder_dim=64,
    decoder_depth=3,
    stylizer_depth=3,
    hooks=(1, 2, 3),
    head_maps=(4, 6, 8, 10),
    head_features=8,
    point_features=6,
)
# Views, styles and sizes that neither the trace nor the export's own verification sees.
UNSEEN = (
    Case(2, 2, (16, 32), (16, 16)),
    Case(5, 1, (80, 48), (48, 80)),
    Case(8, 4, (32, 32), (32, 16)),
)
PROVENANCE = Provenance("test", "CC0-1.0", "5ha")


def small_model(config: ModelConfig = SMALL) -> Styl3r:
    torch.manual_seed(3)
    return build(config)


@pytest.fixture(scope="module")
def halved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One fp16 export of the small network, verified with unseen sizes."""
    folder = tmp_path_factory.mktemp("export") / "fp16"
    report = export_graphs(small_model(), folder, "fp16", provenance=PROVENANCE, cases=UNSEEN)
    assert max(row.worst for row in report.rows) < 2e-5
    assert max(row.worst for row in report.losses) > 1e-5  # rounding is there, and is measured
    return folder


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One fp32 export with its weights in files of their own, as above 2 GB."""
    folder = tmp_path_factory.mktemp("export") / "fp32"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(onnx_export, "EXTERNAL_ABOVE", 1000)
        export_graphs(small_model(), folder, provenance=PROVENANCE, cases=())
    return folder


# ---------------------------------------------------------------------- the contract


@pytest.mark.slow
def test_names_types_and_dynamic_axes_follow_the_contract(halved: Path) -> None:
    structure, appearance = (
        open_session(halved / name) for name in (manifests.STRUCTURE, manifests.APPEARANCE)
    )
    picture = [3, "height", "width"]
    assert {i.name: i.shape for i in structure.get_inputs()} == {
        "images": ["views", *picture],
        "intrinsics": ["views", 3, 3],
    }
    assert {o.name: o.shape for o in structure.get_outputs()} == {
        "means": ["views", "height", "width", 3],
        "scales": ["views", "height", "width", 3],
        "rotations": ["views", "height", "width", 4],
        "opacities": ["views", "height", "width"],
        "content_tokens": ["views", "tokens", 96],
    }
    assert {i.name: i.shape for i in appearance.get_inputs()} == {
        "content_tokens": ["views", "tokens", 96],
        "style_images": ["styles", 3, "style_height", "style_width"],
        "style_weights": ["styles"],
        "images": ["views", *picture],
    }
    (colours,) = appearance.get_outputs()
    assert (colours.name, colours.shape) == ("colours", ["views", "height", "width", 3])
    edges = [*structure.get_inputs(), *structure.get_outputs(), *appearance.get_inputs(), colours]
    assert {edge.type for edge in edges} == {"tensor(float)"}


@pytest.mark.slow
def test_graphs_are_plain_onnx(halved: Path) -> None:
    """No runtime's private operators: any runtime may run them."""
    for name in (manifests.STRUCTURE, manifests.APPEARANCE):
        model = onnx.load(halved / name)
        onnx.checker.check_model(model, full_check=True)
        assert {o.domain for o in model.opset_import} <= {""}
        assert {n.domain for n in model.graph.node} <= {""}


@pytest.mark.parametrize("name", ["structure.onnx", "appearance.onnx"])
def test_loading_bundled_graphs_warns_of_nothing(
    name: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """As any program would load them: onnxruntime names what a graph holds for nothing."""
    onnxruntime.InferenceSession(BUNDLED / "mini" / name)
    assert capfd.readouterr().err == ""


@pytest.mark.slow
def test_each_graph_says_what_it_is(halved: Path) -> None:
    manifest = manifests.read_manifest(halved)
    for name in (manifests.STRUCTURE, manifests.APPEARANCE):
        manifests.check_file(halved, name, manifest)
        props = {p.key: p.value for p in onnx.load(halved / name).metadata_props}
        assert props[manifests.PROP_GRAPH] == name.removesuffix(".onnx")
        assert props[manifests.PROP_MODEL] == manifest.model == "full"
        assert props[manifests.PROP_MODEL_VERSION] == manifest.model_version == "test"
        assert props[manifests.PROP_WEIGHTS_ID] == manifest.weights_id
        assert props[manifests.PROP_PRECISION] == manifest.precision == "fp16"
        assert props[manifests.PROP_LICENCE] == "CC0-1.0"
        assert props[manifests.PROP_SOURCE] == "5ha"
        assert ModelConfig.from_dict(json.loads(props[manifests.PROP_CONFIG])) == SMALL
        assert json.loads(props[manifests.PROP_PAINTING_RANGE]) == [0, 1]
        assert json.loads(props[manifests.PROP_PHOTO_RANGE]) == [-1, 1]
        assert json.loads(props[manifests.PROP_TOOLS])["torch"] == torch.__version__


@pytest.mark.slow
def test_paths_of_the_machine_that_exported_stay_there(halved: Path) -> None:
    here = str(Path(__file__).parents[2]).encode()
    assert not any(here in path.read_bytes() for path in halved.iterdir())


# ---------------------------------------------------------------------- numbers


@pytest.mark.slow
def test_unseen_sizes_agree_with_torch(plain: Path) -> None:
    rows = compare(plain, expected(small_model(), UNSEEN), UNSEEN)
    assert len(rows) == 6 * len(UNSEEN)
    assert max(row.worst for row in rows) < 2e-5


@pytest.mark.slow
def test_weights_above_the_limit_lie_in_a_file_of_their_own(plain: Path) -> None:
    manifest = manifests.read_manifest(plain)
    for name in (manifests.STRUCTURE, manifests.APPEARANCE):
        graph, data = manifests.files_of(name, manifest)
        assert manifest.files[data].bytes > 5 * manifest.files[graph].bytes
    assert set(manifest.files) | {manifests.MANIFEST} == {p.name for p in plain.iterdir()}


@pytest.mark.slow
def test_graphs_become_the_model_again(plain: Path) -> None:
    """Under the parameters' names, also where many of them are equal, as in a new network."""
    again, provenance = load_graphs(plain)
    assert provenance == PROVENANCE
    assert again.config == SMALL
    assert not again.training
    ours, theirs = small_model().state_dict(), again.state_dict()
    for name, value in ours.items():
        assert torch.equal(theirs[name], value if is_needed(name) else torch.zeros_like(value))


@pytest.mark.slow
def test_half_precision_graphs_become_the_rounded_model(halved: Path) -> None:
    model = small_model()
    round_weights(model)
    again, _ = load_graphs(halved)
    for name, value in model.state_dict().items():
        if is_needed(name):
            assert torch.equal(again.state_dict()[name], value), name


@pytest.mark.slow
def test_only_large_weights_are_stored_in_half(halved: Path) -> None:
    parameters = {n for n, _ in small_model().named_parameters()}
    kinds = {True: 0, False: 0}
    for name in (manifests.STRUCTURE, manifests.APPEARANCE):
        for initializer in onnx.load(halved / name).graph.initializer:
            if initializer.name.removesuffix(".T") in parameters:
                large = int(np.prod(initializer.dims)) >= HALF_MIN_ELEMENTS
                kind = onnx.TensorProto.FLOAT16 if large else onnx.TensorProto.FLOAT
                assert initializer.data_type == kind, initializer.name
                kinds[large] += 1
    assert all(kinds.values())


def test_rounding_for_a_reference_is_undone() -> None:
    model = small_model()
    before = {n: v.clone() for n, v in model.state_dict().items()}
    name = "backbone.enc_blocks.0.mlp.fc1.weight"
    with weights_as_stored(model):
        inside = model.get_parameter(name).clone()
    assert torch.equal(inside, rounded(before[name]))
    assert not torch.equal(inside, before[name])
    assert all(torch.equal(v, before[n]) for n, v in model.state_dict().items())


@pytest.mark.parametrize("value", [7e4, np.inf, np.nan])
def test_values_beyond_half_precision_are_refused(value: float) -> None:
    assert to_half(np.float32([65504, -1]), "w").tolist() == [65504, -1]
    with pytest.raises(ModelError, match=r"w: .*fp32"):
        to_half(np.float32([1, value]), "w")


@pytest.mark.slow
def test_mini_agrees_and_fits_its_budget(tmp_path: Path) -> None:
    # As it ships: one that has learnt nothing finds no cameras, and what a solver then gives hangs
    # on the last bit (torch with one thread and with two differs by 4e-3).
    model, _ = load_graphs(BUNDLED / "mini")
    report = export_graphs(model, tmp_path / "mini", "fp16", cases=CASES)
    assert {row.case.views for row in report.rows} == {2, 3, 4, 8}
    assert {row.case.styles for row in report.rows} == {1, 3}
    assert max(row.worst for row in report.rows) < 3e-4
    assert sum(entry.bytes for entry in report.manifest.files.values()) < 32_000_000


@pytest.mark.slow
def test_the_same_model_gives_the_same_bytes(halved: Path, tmp_path: Path) -> None:
    folder = tmp_path / "again"
    export_graphs(small_model(), folder, "fp16", provenance=PROVENANCE, cases=())
    for path in halved.iterdir():
        assert (folder / path.name).read_bytes() == path.read_bytes(), path.name


# ---------------------------------------------------------------------- verification


def test_errors_are_measured_as_documented() -> None:
    truth = np.float32([[0, 3], [-4, 0]])
    row = measure(UNSEEN[0], "x", truth + np.float32([[0, 0], [0.5, 0]]), truth)
    assert row.max_abs == pytest.approx(0.5)
    assert row.max_rel == pytest.approx(0.5 / 4)
    assert row.rms_rel == pytest.approx(0.5 / 5)
    assert row.worst == row.max_rel


@pytest.mark.parametrize("value", [np.float32([[np.nan, 1]]), np.float32([[1.0]])])
def test_nan_and_another_shape_are_infinitely_wrong(value: np.ndarray) -> None:
    assert measure(UNSEEN[0], "x", value, np.float32([[1, 1]])).worst == float("inf")


def test_the_table_has_a_line_for_each_output_and_case() -> None:
    rows = [
        measure(case, name, np.float32([1 + error]), np.float32([1]))
        for case in UNSEEN
        for name, error in (("means", 0.1 * case.views), ("colours", 0.0))
    ]
    lines = table(rows).splitlines()
    assert len(lines) == 1 + len(rows)
    assert "8 views 32x32, 4 styles" in lines[-1]
    worst = worst_of_each_output(rows)
    assert (worst[0].output, worst[0].case.views) == ("means", 8)
    assert len(worst) == 2


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


# ---------------------------------------------------------------------- the command


@pytest.mark.slow
def test_the_command_exports_a_training_checkpoint(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    config = replace(SMALL, name="small")
    model = small_model(config)
    content = {"config": config.to_dict(), "model": model.state_dict()}
    torch.save(content, tmp_path / "run7.pt")
    target = tmp_path / "model"
    assert run(["export", str(tmp_path / "run7.pt"), "-o", str(target), "--no-verify"]) == 0
    assert "small, fp32" in capfd.readouterr().err
    manifest = manifests.read_manifest(target)
    assert (manifest.model, manifest.model_version) == ("small", "run7")
    props = {p.key: p.value for p in onnx.load(target / manifests.STRUCTURE).metadata_props}
    assert props[manifests.PROP_SOURCE] == manifests.sha256_of(tmp_path / "run7.pt")


@pytest.mark.slow
def test_the_command_exports_an_export_again(
    halved: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Weights that were rounded once are not changed by rounding them again."""
    target = tmp_path / "again"
    assert run(["export", str(halved), "-o", str(target), "--precision", "fp16", "-q"]) == 0
    out, err = capfd.readouterr()
    assert "8 views 256x256" in out
    assert "max rel" in out
    assert not err
    first, second = (load_graphs(folder)[0].state_dict() for folder in (halved, target))
    assert all(torch.equal(first[n], second[n]) for n in first)


@pytest.mark.parametrize(
    ("checkpoint", "code", "message"),
    [
        ("text.ckpt", ExitCode.INPUT, "not a torch checkpoint"),
        ("nothing_of_that_name", ExitCode.MODEL, "neither bundled"),
        ("empty", ExitCode.MODEL, "a model is a folder that"),
    ],
)
def test_what_is_no_checkpoint_is_told_in_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    checkpoint: str,
    code: ExitCode,
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("text.ckpt").write_text("hello")
    Path("empty").mkdir()
    assert run(["export", checkpoint, "-o", "model"]) == code
    err = capfd.readouterr().err
    assert message in err
    assert err.count("\n") == 1
    assert not Path("model").exists()


def test_without_the_extra_the_command_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    from styl3r_cli.commands import export

    monkeypatch.setattr(export, "find_spec", lambda name: None if name == "torch" else True)
    assert run(["export", "mini", "-o", str(tmp_path / "m")]) == ExitCode.USAGE
    err = capfd.readouterr().err
    assert "export needs torch" in err
    assert "pip install 'styl3r[export]'" in err
