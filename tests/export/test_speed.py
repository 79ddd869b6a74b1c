"""The comparison with torch: who took how long, in turns, and whether both made one picture."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from small_network import PROVENANCE, SMALL
from tiny_model import APPEARANCE_GRAPH, write_model

from styl3r_cli.errors import ModelError
from styl3r_cli.photos import load_photos, load_style
from styl3r_export.export_graphs import export_graphs
from styl3r_export.model import build
from styl3r_export.speed import __main__ as command
from styl3r_export.speed.compare import Timed, started
from styl3r_export.speed.worker import TorchNetwork

CONFIG = replace(SMALL, name="small")


def spent(seconds: float, processor: float) -> dict[str, float]:
    return {"structure": 0.75 * seconds, "appearance": 0.25 * seconds, "processor": processor}


def write_checkpoint(path: Path, seed: int) -> torch.nn.Module:
    torch.manual_seed(seed)
    model = build(CONFIG)
    torch.save({"config": CONFIG.to_dict(), "model": model.state_dict()}, path)
    return model.eval()


def compared(checkpoint: Path, models: Sequence[Path], *others: object) -> list[str]:
    """The lines of the table, the heading left out."""
    arguments = list(map(str, [checkpoint, *models, *others]))
    result = CliRunner().invoke(command.main, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output.splitlines()[1:]


def decibels(line: str) -> float:
    return float(re.findall(r"([\d.]+) dB", line)[0])


def test_ratios_are_medians_of_neighbouring_passes() -> None:
    """A minute in which the machine was busy slows both of a pair, and changes no ratio."""
    timed = Timed("model", 0.0, [spent(1, 2), spent(10, 2), spent(1, 1)])
    timed.beside = [spent(3, 8), spent(30, 8), spent(100, 8)]
    assert timed.faster() == pytest.approx(3)
    assert timed.less_work() == pytest.approx(4)
    assert timed.median("structure") == 0.75


def test_models_take_turns_with_the_reference(
    tiny_model: Path,
    photos: list[Path],
    style: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With graphs in torch's place, which load at once."""
    monkeypatch.setattr(command, "TORCH", str(tiny_model))
    checkpoint, kept = tmp_path / "weights.pt", tmp_path / "kept"
    checkpoint.write_bytes(bytes(3_000_000))
    darker = APPEARANCE_GRAPH.replace("value_float = 0.5>", "value_float = 0.25>")
    models = [write_model(tmp_path / "same"), write_model(tmp_path / "darker", appearance=darker)]
    options = ("--photos", photos[0].parent, "--style", style, "--repeats", 2)
    monkeypatch.setattr(command, "_keep", lambda *given: seen.append(given[1:]))
    seen: list[tuple[str, list[np.ndarray]]] = []
    same, darker, reference = compared(checkpoint, models, *options, "--keep", kept)
    assert (same.split()[0], darker.split()[0]) == ("same", "darker")
    assert decibels(same) == 100 > 40 > decibels(darker)
    assert "dB" not in reference
    assert re.search(r" 1\.00 +1\.00 +\d+ MB +100% +3 MB$", reference)  # compared with itself
    assert [len(pictures) for _, pictures in seen] == [3, 3, 3]  # of two views and from between


def test_torchs_pass_is_the_networks(photos: list[Path], style: Path, tmp_path: Path) -> None:
    model = write_checkpoint(tmp_path / "weights.pt", 0)
    threads = torch.get_num_threads()
    network = TorchNetwork(str(tmp_path / "weights.pt"))
    torch.set_num_threads(threads)
    views, painting = load_photos(photos[:2], (32, 32)), load_style(style, 32).image
    scene = network.encode(views)
    inputs = [torch.from_numpy(a) for a in (views.images, views.intrinsics)]
    with torch.inference_mode():
        tokens = model.structure(*inputs)
        styles = torch.from_numpy(np.stack([painting, painting[::-1].copy()]))
        want = model.appearance(tokens[-1], styles, torch.tensor([0.5, 0.5]), inputs[0])
    np.testing.assert_allclose(scene.means, tokens[0], rtol=1e-5, atol=1e-6)
    found = network.colours(scene, [painting, painting[::-1]])
    np.testing.assert_allclose(found, want, rtol=1e-4, atol=1e-5)


def test_a_process_that_ends_is_told(photos: list[Path], style: Path, tmp_path: Path) -> None:
    job = {"kind": str(tmp_path / "none"), "checkpoint": ""}
    job |= {"photos": list(map(str, photos)), "styles": [str(style)]}
    with pytest.raises(ModelError, match="exit code 1"), started(job):
        pass


@pytest.mark.slow
def test_torch_and_its_export_make_one_picture(
    photos: list[Path], style: Path, tmp_path: Path
) -> None:
    models = [tmp_path / "same", tmp_path / "other"]
    for seed, folder in enumerate(models):
        model = write_checkpoint(folder.with_suffix(".pt"), seed)
        export_graphs(model, folder, provenance=PROVENANCE, cases=())
    options = ("--photos", photos[0].parent, "--style", style, "--repeats", 1)
    same, other, reference = compared(tmp_path / "same.pt", models, *options)
    assert decibels(same) > 60 > 40 > decibels(other)
    assert reference.startswith("torch")
