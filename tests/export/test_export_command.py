"""The command `export`: checkpoints and exports in, one line for what is neither."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import onnx
import pytest
import torch
from small_network import SMALL, small_model

from styl3r_cli import manifest as manifests
from styl3r_cli.errors import ExitCode
from styl3r_cli.main import run
from styl3r_export.graphs_reading import load_graphs


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
