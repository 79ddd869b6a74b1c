"""Models: found, verified, refused with one line that says why, and run."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import time
from pathlib import Path
from threading import Timer

import numpy as np
import pytest
from tiny_model import APPEARANCE_GRAPH, STRUCTURE_GRAPH, parse_graph, write_manifest, write_model

from styl3r_cli import graphs
from styl3r_cli import manifest as manifests
from styl3r_cli.errors import ModelError, UsageError
from styl3r_cli.graphs import Model
from styl3r_cli.limits import available_cores
from styl3r_cli.sessions import Graph, providers

onnx = pytest.importorskip("onnx")


@pytest.fixture
def folder(tiny_model: Path, tmp_path: Path) -> Path:
    """A copy of the tiny model that a test may damage."""
    return Path(shutil.copytree(tiny_model, tmp_path / "model"))


def test_metadata_tells_how_pictures_are_read(tiny_model: Path) -> None:
    model = Model.load(str(tiny_model), "cpu", threads=1)
    assert (model.name, model.device) == ("tiny", "cpu")
    assert model.style_range == (0.0, 1.0)
    assert model.content_range == (-1.0, 1.0)
    assert model.input_size == (64, 64)


def test_ranges_follow_the_graph(tmp_path: Path) -> None:
    folder = write_model(tmp_path / "m")
    path = folder / manifests.APPEARANCE
    proto = onnx.load(path)
    for prop in proto.metadata_props:
        if prop.key == manifests.PROP_PHOTO_RANGE:
            prop.value = "[0, 1]"
    path.write_bytes(proto.SerializeToString())
    write_manifest(folder)
    assert Model.load(str(folder), "cpu").content_range == (0.0, 1.0)


@pytest.mark.parametrize("file", [manifests.STRUCTURE, manifests.APPEARANCE])
def test_one_flipped_bit_is_found(folder: Path, file: str) -> None:
    data = bytearray((folder / file).read_bytes())
    data[len(data) // 2] ^= 1
    (folder / file).write_bytes(data)
    with pytest.raises(ModelError, match=rf"{file}: damaged \(checksum differs\)"):
        Model.load(str(folder), "cpu")


def test_garbage_with_a_fitting_checksum_is_no_model(folder: Path) -> None:
    (folder / manifests.STRUCTURE).write_bytes(b"not a graph")
    write_manifest(folder)
    with pytest.raises(ModelError, match=r"structure\.onnx: cannot be loaded: ") as caught:
        Model.load(str(folder), "cpu")
    assert "\n" not in str(caught.value)


def test_a_broken_node_is_told_in_a_short_line(tmp_path: Path) -> None:
    """Onnxruntime's message holds the signatures of its C++ functions. Found by fuzzing."""
    graph = parse_graph(ENDLESS_GRAPH)
    del graph.graph.node[0].attribute[:]  # of a constant: its value
    path = tmp_path / "a.onnx"
    path.write_bytes(graph.SerializeToString())
    with pytest.raises(ModelError, match="Constant") as caught:
        Graph.load(path, "cpu", 1)
    assert len(str(caught.value)) < 300 + len(str(path))
    assert "onnxruntime::" not in str(caught.value)


def test_names_of_axes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    """Found by fuzzing."""
    good = parse_graph(ENDLESS_GRAPH.replace("[N]", "[Axis]")).SerializeToString()
    path = tmp_path / "a.onnx"
    path.write_bytes(good.replace(b"Axis", b"\x8fxis"))
    with pytest.raises(ModelError, match="cannot be loaded") as caught:
        Graph.load(path, "cpu", 1)
    assert "\n" not in str(caught.value)


def test_a_damaged_graph_says_nothing_on_standard_output(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Results go there; onnxruntime's second attempts would tell of themselves between them."""
    good = (folder / manifests.STRUCTURE).read_bytes()
    assert b"AveragePool" in good
    (folder / manifests.STRUCTURE).write_bytes(good.replace(b"AveragePool", b"Averag\xff\xfeool"))
    write_manifest(folder)
    for device in ("cpu", "auto"):
        with pytest.raises(ModelError, match="cannot be loaded"):
            Model.load(str(folder), device)
    assert capsys.readouterr() == ("", "")


def test_graphs_of_two_models_do_not_mix(folder: Path) -> None:
    other = parse_graph(APPEARANCE_GRAPH, **{manifests.PROP_WEIGHTS_ID: "another"})
    (folder / manifests.APPEARANCE).write_bytes(other.SerializeToString())
    write_manifest(folder)
    with pytest.raises(ModelError, match="does not belong to this manifest"):
        Model.load(str(folder), "cpu")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"intrinsics": "matrices"}, "has no input 'intrinsics'"),
        ({"opacities": "alphas"}, "has no output 'opacities'"),
        ({"[N,3,H,W] images": "[N,3,H,W] images, float[N] times"}, "unknown input 'times'"),
        (
            {
                "float[N,H,W] opacities": "float[H] opacities",
                "opacities = Expand (solid, size)": "opacities = Expand (solid, height)",
            },
            r"output 'opacities' is a tensor\(float\) of rank 1, expected .* rank 3",
        ),
    ],
)
def test_other_signatures_are_named(tmp_path: Path, changes: dict, message: str) -> None:
    text = STRUCTURE_GRAPH
    for old, new in changes.items():
        text = text.replace(old, new)
    with pytest.raises(ModelError, match=message):
        Model.load(str(write_model(tmp_path / "m", structure=text)), "cpu")


def test_half_precision_edges_are_refused(tmp_path: Path) -> None:
    text = STRUCTURE_GRAPH.replace("float[N,L,3] content_tokens", "float16[N,L,3] content_tokens")
    text = text.replace(
        "content_tokens = Transpose <perm = [0, 2, 1]> (flat)",
        "wide = Transpose <perm = [0, 2, 1]> (flat) content_tokens = Cast <to = 10> (wide)",
    )
    with pytest.raises(ModelError, match=r"'content_tokens' is a tensor\(float16\)"):
        Model.load(str(write_model(tmp_path / "m", structure=text)), "cpu")


def test_weights_outside_the_folder_are_refused(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "secret").write_bytes(np.zeros(1, np.float32).tobytes())
    path = folder / manifests.STRUCTURE
    proto = onnx.load(path)
    constant = next(node for node in proto.graph.node if node.output[0] == "solid")
    proto.graph.node.remove(constant)
    weight = proto.graph.initializer.add(name="solid", dims=[1], data_type=1)
    weight.data_location = onnx.TensorProto.EXTERNAL
    weight.external_data.add(key="location", value="../secret")
    path.write_bytes(proto.SerializeToString())
    write_manifest(folder)
    with pytest.raises(ModelError, match="External data path"):
        Model.load(str(folder), "cpu")


def test_weights_in_files_of_any_name_are_checked(folder: Path) -> None:
    (folder / "weights.bin").write_bytes(b"as they were")
    write_manifest(folder)
    Model.load(str(folder), "cpu")
    (folder / "weights.bin").write_bytes(b"as they are!")
    with pytest.raises(ModelError, match=r"weights\.bin: damaged \(checksum differs\)"):
        Model.load(str(folder), "cpu")


@pytest.mark.parametrize(
    ("key", "text"),
    [
        (manifests.PROP_INPUT_SIZE, "[NaN, 256]"),
        (manifests.PROP_INPUT_SIZE, "[1e400, 256]"),
        (manifests.PROP_INPUT_SIZE, "[-256, 256]"),
        (manifests.PROP_INPUT_SIZE, "[100, 100]"),
        (manifests.PROP_INPUT_SIZE, "[" * 100_000),
        (manifests.PROP_PAINTING_RANGE, "[NaN, 1]"),
        (manifests.PROP_PAINTING_RANGE, "x" * 100_000),
        (manifests.PROP_PHOTO_RANGE, "[0, 1e40]"),
    ],
)
def test_numbers_of_a_graph_that_are_none_are_refused(folder: Path, key: str, text: str) -> None:
    for path in folder.glob("*.onnx"):
        proto = onnx.load(path)
        for prop in proto.metadata_props:
            if prop.key == key:
                prop.value = text
        path.write_bytes(proto.SerializeToString())
    write_manifest(folder)
    with pytest.raises(ModelError, match=f"metadata {key}") as caught:
        Model.load(str(folder), "cpu")
    assert len(str(caught.value)) < 400 + len(str(folder))


def test_missing_things_are_named(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"no model 'maxi': neither bundled .* nor a folder"):
        Model.load("maxi")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ModelError, match=r"no manifest\.json"):
        Model.load(str(tmp_path / "empty"))
    (folder / manifests.APPEARANCE).unlink()
    with pytest.raises(ModelError, match=r"appearance\.onnx: missing"):
        Model.load(str(folder), "cpu")


def test_newer_manifests_are_refused(folder: Path) -> None:
    path = folder / manifests.MANIFEST
    path.write_text(json.dumps(json.loads(path.read_text()) | {"format_version": 99}))
    with pytest.raises(ModelError, match="format version 99"):
        Model.load(str(folder))


def test_devices(tiny_model: Path) -> None:
    import onnxruntime

    with pytest.raises(UsageError, match="--device tpu"):
        Model.load(str(tiny_model), "tpu")
    if "CUDAExecutionProvider" in onnxruntime.get_available_providers():
        pytest.skip("this onnxruntime has CUDA")
    assert Model.load(str(tiny_model), "auto").device == "cpu"
    with pytest.raises(UsageError, match="onnxruntime-gpu"):
        Model.load(str(tiny_model), "cuda")


def test_cuda_is_preferred_and_its_libraries_are_looked_for_silently(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import onnxruntime

    cuda, cpu = "CUDAExecutionProvider", "CPUExecutionProvider"
    looked: list[str] = []

    def preload() -> None:
        looked.append("for libraries")
        print("Failed to load libcublas")

    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: [cuda, cpu])
    monkeypatch.setattr(onnxruntime, "preload_dlls", preload)
    assert providers("cpu") == [cpu]
    assert not looked
    assert providers("auto") == providers("cuda") == [cuda, cpu]
    assert len(looked) == 2
    assert capsys.readouterr().out == ""


def test_one_scene_loads_a_small_structure_graph_as_it_is(
    tiny_model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    optimised: dict[str, bool] = {}
    load = Graph.load

    def recorded(
        path: Path, device: str, threads: int | None = None, optimise: bool = True
    ) -> Graph:
        optimised[path.name] = optimise
        return load(path, device, threads, optimise)

    monkeypatch.setattr(Graph, "load", recorded)
    rng = np.random.default_rng(0)
    feeds = {
        "images": rng.random((2, 3, 32, 32), np.float32),
        "intrinsics": np.tile(np.diag([0.8, 0.8, 1]), (2, 1, 1)),
    }
    often = Model.load(str(tiny_model), "cpu", 1).structure(feeds)
    assert optimised == {"structure.onnx": True, "appearance.onnx": True}
    once = Model.load(str(tiny_model), "cpu", 1, one_scene=True).structure(feeds)
    assert optimised == {"structure.onnx": False, "appearance.onnx": True}
    for name, values in often.items():
        np.testing.assert_allclose(once[name], values, rtol=1e-5, atol=1e-6)
    monkeypatch.setattr(graphs, "SMALL_GRAPH", 100)
    Model.load(str(tiny_model), "cpu", 1, one_scene=True)
    assert optimised == {"structure.onnx": True, "appearance.onnx": True}


def test_impossible_input_is_one_line(tiny_model: Path) -> None:
    graph = Graph.load(tiny_model / manifests.STRUCTURE, "cpu")
    with pytest.raises(ModelError, match="the graph failed") as caught:
        graph({"images": np.zeros((2, 5, 32, 32)), "intrinsics": np.zeros((2, 3, 3))})
    assert "\n" not in str(caught.value)


def test_cores_are_those_this_process_may_use() -> None:
    assert available_cores() >= 1


# Counts to a number that no machine reaches while the test runs.
ENDLESS_GRAPH = """
<ir_version: 10, opset_import: ["" : 18]>
endless (float[N] x) => (float[N] y)
{
  trips = Constant <value_int = 1000000000000> ()
  true = Constant <value_int = 1> ()
  on = Cast <to = 9> (true)
  y = Loop (trips, on, x) <body = step (int64 i, bool go, float[N] a) => (bool go_on, float[N] b) {
    go_on = Identity (go)
    b = Sin (a)
  }>
}
"""


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_ctrl_c_ends_a_run(tmp_path: Path) -> None:
    path = tmp_path / "endless.onnx"
    path.write_bytes(parse_graph(ENDLESS_GRAPH).SerializeToString())
    graph = Graph.load(path, "cpu", threads=1)
    Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
    start = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        graph({"x": np.ones(4)})
    assert time.perf_counter() - start < 10
