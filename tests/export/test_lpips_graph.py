"""LPIPS as a graph: against published weights' distances, and never written unverified."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner

from styl3r_cli.tradeoff.perceptual import Perceptual
from styl3r_export.evaluate import lpips

CHANNELS = (3, 64, 192, 384, 256, 256)
KERNELS = (11, 5, 3, 3, 3)


@pytest.fixture(scope="module")
def teacher() -> Path:
    """The folder of the published weights."""
    beside = Path(__file__).parents[3] / "shared"
    folder = Path(os.environ.get("STYL3R_SHARED", beside)) / "teachers" / "lpips"
    if not folder.is_dir():
        pytest.skip("the teachers are not here (set STYL3R_SHARED to their parent folder)")
    return folder


def random_weights(path: Path) -> Path:
    """Weights of the right shapes."""
    random, weights = np.random.default_rng(0), {}
    for level, (layer, *_) in enumerate(lpips.LAYERS):
        before, after, side = CHANNELS[level], CHANNELS[level + 1], KERNELS[level]
        spread = np.sqrt(2 / (before * side * side))
        shape = (after, before, side, side)
        weights[f"features.{layer}.weight"] = (random.standard_normal(shape) * spread).astype("f2")
        weights[f"features.{layer}.bias"] = random.random(after).astype("f2") / 10
        weights[f"lin{level}.weight"] = random.random((1, after, 1, 1)).astype("f4")
    np.savez(path, **weights)
    return path


def test_the_graph_gives_the_published_distances(teacher: Path, tmp_path: Path) -> None:
    path = tmp_path / "lpips.onnx"
    assert lpips.export(teacher / "lpips_alex.npz", path) < 1e-5
    with np.load(teacher / "check.npz") as check:
        a, b = (check[f"image{k}"][0].transpose(1, 2, 0) for k in (0, 1))
        truth = float(check["lpips_alex"])
    height, width = a.shape[:2]
    graph = Perceptual(path, (width, height))
    assert graph(a, b) == pytest.approx(truth, abs=2e-6)
    assert graph(b, a) == pytest.approx(truth, abs=2e-6)


def test_what_differs_from_torch_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    weights, path = random_weights(tmp_path / "w.npz"), tmp_path / "lpips.onnx"
    command = [str(weights), "-o", str(path)]
    done = CliRunner().invoke(lpips.main, command)
    assert (done.exit_code, "from torch at most" in done.output) == (0, True), done.output
    path.unlink()
    truth = lpips.Lpips.__call__
    monkeypatch.setattr(lpips.Lpips, "__call__", lambda *given: 1.01 * truth(*given))
    done = CliRunner().invoke(lpips.main, command)
    assert (done.exit_code, "differs from torch" in done.output) == (4, True), done.output
    assert [each.name for each in tmp_path.iterdir()] == ["w.npz"]


def test_other_files_are_no_weights(tmp_path: Path) -> None:
    other, damaged = tmp_path / "other.npz", tmp_path / "damaged.npz"
    np.savez(other, **{"features.0.weight": np.zeros((64, 3, 11, 11), np.float32)})
    damaged.write_bytes(other.read_bytes()[:100])
    single, checkpoint = tmp_path / "single.npy", tmp_path / "net.pth"
    np.save(single, np.zeros(3))
    torch.save({"features.0.weight": torch.zeros(3)}, checkpoint)  # a zip archive, too
    told_of = dict.fromkeys((damaged, single, checkpoint), "not an .npz file")
    for path, told in {other: "no features.0.bias", **told_of}.items():
        done = CliRunner().invoke(lpips.main, [str(path), "-o", str(tmp_path / "x.onnx")])
        assert (done.exit_code, told in done.output) == (3, True), done.output
    assert not (tmp_path / "x.onnx").exists()
