"""Other precisions of exported graphs: what they touch, keep, lose and refuse; without torch."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import helper, numpy_helper
from tiny_model import APPEARANCE_GRAPH, STRUCTURE_GRAPH, parse_graph, write_model

from styl3r_cli import main
from styl3r_cli import manifest as manifests
from styl3r_cli.errors import ModelError, OutputError
from styl3r_cli.graphs import Model
from styl3r_cli.photos import load_photos, load_style
from styl3r_cli.pipeline import Stylizer
from styl3r_export.quantise import folders, loss
from styl3r_export.quantise.calibration import Sample
from styl3r_export.quantise.folders import convert_folder
from styl3r_export.quantise.storage import LARGEST_INT8, to_int8
from styl3r_export.quantise.variants import VARIANTS

CHANNELS = 64
WIDTH = 128
# A stylized picture by known means, plus a tenth of what a small network makes of the photo.
NETWORK = """
  inner = Conv <kernel_shape = [3, 3], pads = [1, 1, 1, 1]> (images, first_weight)
  rectified = Relu (inner)
  deep = Conv <kernel_shape = [3, 3], pads = [1, 1, 1, 1]> (rectified, head_body_weight)
  last = Conv <kernel_shape = [1, 1]> (deep, head_last_weight)
  pixel_rows = Transpose <perm = [0, 2, 3, 1]> (last)
  wide = MatMul (pixel_rows, wide_weight)
  mixed = MatMul (wide, mixing_weight)
  probabilities = Softmax (mixed)
  narrow = MatMul (probabilities, narrow_weight)
  plain = Add (half_photo, half_style)
  colours = Add (plain, narrow)
}
"""


# One map that a head for places and a head for looks both read, behind a matrix product.
HEADS = """
  stem = Conv <kernel_shape = [3, 3], pads = [1, 1, 1, 1]> (images, stem_weight)
  stem_rows = Transpose <perm = [0, 2, 3, 1]> (stem)
  tokens = MatMul (stem_rows, tokens_weight)
  map = Transpose <perm = [0, 3, 1, 2]> (tokens)
  looks = Conv <kernel_shape = [3, 3], pads = [1, 1, 1, 1]> (map, gaussian_param_head_body)
  looks_last = Conv <kernel_shape = [1, 1]> (looks, gaussian_param_head_last)
  places = Conv <kernel_shape = [3, 3], pads = [1, 1, 1, 1]> (map, downstream_head_body)
  places_last = Conv <kernel_shape = [1, 1]> (places, downstream_head_last)
  head_axis = Constant <value_ints = [1]> ()
  z_offset = Squeeze (places_last, head_axis)
  logits = Squeeze (looks_last, head_axis)
"""


def add_weights(model: onnx.ModelProto, shapes: dict[str, tuple[int, ...]]) -> None:
    """Random values for what a parsed graph declared as inputs so that it could be checked."""
    random = np.random.default_rng(0)
    for name, shape in shapes.items():
        fan_in = np.prod(shape[1:]) if len(shape) == 4 else shape[0]
        values = random.standard_normal(shape).astype(np.float32) / np.float32(fan_in**0.5)
        model.graph.initializer.append(numpy_helper.from_array(values, name))
    inputs = [value for value in model.graph.input if value.name not in shapes]
    del model.graph.input[:]
    model.graph.input.extend(inputs)


def declared(shapes: dict[str, tuple[int, ...]]) -> str:
    return ", ".join(f"float[{','.join(map(str, s))}] {n}" for n, s in shapes.items())


@pytest.fixture
def two_heads(tmp_path: Path) -> Path:
    """A model whose points and opacities come from two heads."""
    folder = write_model(tmp_path / "two_heads")
    shapes = {
        "stem_weight": (WIDTH, 3, 3, 3),
        "tokens_weight": (WIDTH, WIDTH),
        "gaussian_param_head_body": (CHANNELS, WIDTH, 3, 3),
        "gaussian_param_head_last": (1, CHANNELS, 1, 1),
        "downstream_head_body": (CHANNELS, WIDTH, 3, 3),
        "downstream_head_last": (1, CHANNELS, 1, 1),
    }
    text = STRUCTURE_GRAPH.replace("intrinsics)\n", f"intrinsics, {declared(shapes)})\n")
    text = text.replace("  zero = ", f"{HEADS}  zero = ", 1)
    text = text.replace("  z = Add (brightness, two)", "  z = Add (z_offset, two)")
    text = text.replace("  opacities = Expand (solid, size)", "  opacities = Sigmoid (logits)")
    properties = {p.key: p.value for p in onnx.load(folder / manifests.STRUCTURE).metadata_props}
    model = parse_graph(text, **properties)
    add_weights(model, shapes)
    onnx.save(model, folder / manifests.STRUCTURE)
    described = manifests.Manifest(
        "tiny", "1", "known geometry", "fp32", manifests.describe_files(folder)
    )
    (folder / manifests.MANIFEST).write_text(described.to_json())
    return folder


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model with large and small matrices and convolutions."""
    folder = write_model(tmp_path_factory.mktemp("source"))
    text = APPEARANCE_GRAPH.replace("  colours = Add (half_photo, half_style)\n}\n", NETWORK)
    text = text.replace("images)\n  =>", "images, WEIGHTS)\n  =>")
    shapes = {
        "first_weight": (CHANNELS, 3, 3, 3),
        "head_body_weight": (CHANNELS, CHANNELS, 3, 3),
        "head_last_weight": (3, CHANNELS, 1, 1),
        "wide_weight": (3, WIDTH),
        "mixing_weight": (WIDTH, WIDTH),
        "narrow_weight": (WIDTH, 3),
    }
    original = onnx.load(folder / manifests.APPEARANCE)
    properties = {p.key: p.value for p in original.metadata_props}
    model = parse_graph(text.replace("WEIGHTS", declared(shapes)), **properties)
    add_weights(model, shapes)
    helper.set_model_props(model, {**properties, manifests.PROP_PRECISION: "fp32"})
    onnx.save(model, folder / manifests.APPEARANCE)
    described = manifests.Manifest(
        "tiny", "1", "known geometry", "fp32", manifests.describe_files(folder)
    )
    (folder / manifests.MANIFEST).write_text(described.to_json())
    return folder


@pytest.fixture
def samples(photos: list[Path], style: Path) -> list[Sample]:
    return [Sample("three", load_photos(photos, (64, 64)), [load_style(style, 64).image])]


def weights_of(folder: Path) -> dict[str, np.ndarray]:
    graph = onnx.load(folder / manifests.APPEARANCE).graph
    return {tensor.name: numpy_helper.to_array(tensor) for tensor in graph.initializer}


def operators_of(folder: Path) -> Counter[str]:
    return Counter(n.op_type for n in onnx.load(folder / manifests.APPEARANCE).graph.node)


@settings(max_examples=50, deadline=None)
@given(
    st.integers(1, 5), st.integers(1, 5), st.integers(0, 1), st.floats(1e-3, 1e3), st.integers(0, 9)
)
def test_integers_are_within_half_a_step(
    rows: int, columns: int, axis: int, size: float, seed: int
) -> None:
    values = np.random.default_rng(seed).standard_normal((rows, columns)).astype(np.float32)
    values *= np.float32(size)
    values[0] = 0  # a channel of zeros has a scale too
    integers, scales = to_int8(values, axis)
    assert np.abs(integers).max() <= LARGEST_INT8
    assert scales.shape == tuple(n if i == axis else 1 for i, n in enumerate(values.shape))
    assert (np.abs(integers * scales - values) <= scales * 0.5001).all()


@pytest.mark.parametrize(
    ("precision", "new", "bytes_share", "decibels"),
    [
        ("fp16", set(), 0.55, 60),
        ("w8", set(), 0.3, 45),
        ("w4", {"MatMulNBits"}, 0.3, 40),
        ("int8", {"MatMulInteger", "DynamicQuantizeLinear"}, 0.3, 40),
        ("int8-static", {"MatMulInteger", "QuantizeLinear", "DequantizeLinear"}, 0.3, 35),
        ("mixed", {"MatMulInteger", "QuantizeLinear", "DequantizeLinear"}, 0.3, 35),
    ],
)
def test_each_precision_touches_large_weights_only(
    source: Path,
    samples: list[Sample],
    tmp_path: Path,
    precision: str,
    new: set[str],
    bytes_share: float,
    decibels: float,
) -> None:
    manifest, losses = convert_folder(source, tmp_path / "m", precision, samples)
    assert manifest.precision == manifests.read_manifest(tmp_path / "m").precision == precision
    assert losses[0].worst >= decibels
    before, after = weights_of(source), weights_of(tmp_path / "m")
    for name in ("first_weight", "head_last_weight", "wide_weight", "narrow_weight"):
        assert (after[name] == before[name]).all()
    large = sum(a.nbytes for n, a in before.items() if a.size >= 128 * 128)
    small = sum(a.nbytes for n, a in before.items()) - large
    assert sum(a.nbytes for a in after.values()) - small <= bytes_share * large
    operators = operators_of(tmp_path / "m")
    assert new <= set(operators)
    for kept in ("Softmax", "Relu", "Conv", "Transpose"):
        assert operators[kept] == operators_of(source)[kept] or VARIANTS[precision].calibrated
    assert operators["Softmax"] == 1
    model = Model.load(str(tmp_path / "m"), "cpu")
    assert model.appearance.metadata[manifests.PROP_PRECISION] == precision


def test_mixed_rounds_how_gaussians_look_and_not_where_they_are(
    two_heads: Path, samples: list[Sample], tmp_path: Path
) -> None:
    convert_folder(two_heads, tmp_path / "m", "mixed", samples)
    graph = onnx.load(tmp_path / "m" / manifests.STRUCTURE).graph
    types = {tensor.name: tensor.data_type for tensor in graph.initializer}
    assert types["tokens_weight/integers"] == onnx.TensorProto.INT16
    assert types["downstream_head_body"] == onnx.TensorProto.FLOAT
    assert "gaussian_param_head_body" not in types
    exact, mixed = (
        Stylizer(str(folder), "cpu").encode(samples[0].photos)
        for folder in (two_heads, tmp_path / "m")
    )
    # Sixteen bits: a twentieth of the error that a rounded input of the head would make.
    assert np.abs(mixed.means - exact.means).max() < 5e-4
    assert 1e-4 < np.abs(mixed.opacities - exact.opacities).max() < 0.1


def test_large_graphs_keep_weights_in_a_file_that_all_may_read(
    source: Path, samples: list[Sample], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folders, "EXTERNAL_ABOVE", 1000)
    convert_folder(source, tmp_path / "m", "w8", samples)
    graph = tmp_path / "m" / manifests.APPEARANCE
    beside = graph.with_name(f"{graph.name}.data")
    assert beside.stat().st_size > graph.stat().st_size
    assert beside.stat().st_mode == graph.stat().st_mode


def test_fp16_and_back_computes_the_same_bits(
    source: Path, samples: list[Sample], tmp_path: Path
) -> None:
    convert_folder(source, tmp_path / "half", "fp16", [], verify=False)
    convert_folder(tmp_path / "half", tmp_path / "wide", "fp32", [], verify=False)
    assert all(array.dtype != np.float16 for array in weights_of(tmp_path / "wide").values())
    made = loss._scenes(tmp_path / "half", samples) + loss._scenes(tmp_path / "wide", samples)
    (half, _), (wide, _) = (each for each in made if each)
    assert (half.colours == wide.colours).all()


def test_what_breaks_a_scene_is_not_written(
    source: Path, samples: list[Sample], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loss, "BROKEN_DB", 99.0)
    with pytest.raises(ModelError, match=r"w4 breaks the scene of three.*nothing written"):
        convert_folder(source, tmp_path / "m", "w4", samples)
    assert not (tmp_path / "m").exists()
    convert_folder(source, tmp_path / "m", "w4", samples, verify=False)


def test_quantised_models_and_folders_in_use_are_refused(
    source: Path, samples: list[Sample], tmp_path: Path
) -> None:
    convert_folder(source, tmp_path / "m", "w8", [], verify=False)
    with pytest.raises(ModelError, match=r"is w8 already; start from"):
        convert_folder(tmp_path / "m", tmp_path / "n", "int8", samples)
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "thesis.txt").write_text("years of work")
    with pytest.raises(OutputError, match="holds something else"):
        convert_folder(source, tmp_path / "used", "w8", samples)


def test_a_model_is_not_replaced_by_what_is_made_from_it(
    source: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "link").symlink_to(source)
    before = manifests.read_manifest(source)
    for target in (source, tmp_path / "link", f"{source}/../{source.name}"):
        assert main.run(["export", str(source), "-o", str(target), "--precision", "w8"]) == 2
        assert "is also an input" in capfd.readouterr().err
    assert manifests.read_manifest(source) == before


def test_the_command_quantises_and_tells(
    source: Path, photos: list[Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "m"
    given_ = ["export", str(source), "-o", str(target), "--precision"]
    assert main.run([*given_, "int8-static"]) == 2
    assert "calibrated on photos" in capfd.readouterr().err
    assert main.run([*given_, "int8", "--photos", str(photos[0].parent)]) == 0
    out, err = capfd.readouterr()
    assert "photos" in out.splitlines()[2]
    assert "int8" in err
    assert manifests.read_manifest(target).precision == "int8"
    assert main.run([*given_, "fp32", "--photos", str(photos[0].parent)]) == 2


def test_every_precision_of_the_command_is_one_that_can_be_made() -> None:
    from styl3r_cli.commands.export import HELP, command

    option = next(p for p in command.params if p.name == "precision")
    assert list(option.type.choices) == list(VARIANTS)
    assert all(f"\n  {name} " in HELP for name in VARIANTS)


def test_quantising_needs_no_torch(source: Path, tmp_path: Path, run_python: Callable) -> None:
    run_python(
        "import sys; sys.modules['torch'] = None\n"
        "from styl3r_cli.main import run\n"
        f"assert run(['export', {str(source)!r}, '-o', {str(tmp_path / 'm')!r}, '--no-verify', "
        "'--precision', 'int8']) == 0"
    )


@pytest.fixture
def run_python() -> Callable[[str], None]:
    def run(code: str) -> None:
        result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert result.returncode == 0, result.stderr

    return run
