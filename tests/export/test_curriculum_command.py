"""`python -m styl3r_export.curriculum`: every stage from the command line, on small data."""

from __future__ import annotations

import csv
import io
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from blurred_scales import Blur
from PIL import Image

from styl3r_export.curriculum import __main__ as command
from styl3r_export.curriculum.trainer import load_checkpoint
from styl3r_export.model import ModelConfig
from styl3r_export.scenes.shards import Plan, write_shard
from styl3r_export.scenes.textures import TextureBank

SIZE, FRAMES = 64, 30  # videos must be longer than RE10K's first gap of 25 frames


@pytest.fixture(autouse=True)
def no_download(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "load_perceptual", lambda _: Blur())


@pytest.fixture(scope="module")
def shards(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Scenes to train on, and others."""
    folders = {}
    for seed, name in enumerate(("data", "held-out")):
        folders[name] = tmp_path_factory.mktemp(name)
        plan = Plan(seed=seed, views=4, size=(SIZE, SIZE), scenes=2)
        write_shard(folders[name], 0, plan, TextureBank.procedural(0))
    return folders


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One chunk with one video, a camera that walks past a pattern, in RealEstate10K's size."""
    folder = tmp_path_factory.mktemp("re10k")
    pattern = np.random.default_rng(0).integers(0, 255, (18, 32, 3), np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(pattern).resize((640, 360)).save(buffer, "JPEG")
    frame = torch.frombuffer(bytearray(buffer.getvalue()), dtype=torch.uint8)
    cameras = torch.zeros(FRAMES, 18)
    cameras[:, :4] = torch.tensor([0.5, 0.9, 0.5, 0.5])
    cameras[:, 6:] = torch.eye(4)[:3].flatten()
    cameras[:, 9] = torch.arange(FRAMES) * 0.02
    video = {
        "key": "walk", "images": [frame] * FRAMES, "cameras": cameras,
        "timestamps": torch.arange(FRAMES),
    }  # fmt: skip
    torch.save([video], folder / "000000.torch")
    return folder


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    rng = np.random.default_rng(0)
    for number in range(12):
        pixels = rng.integers(0, 255, (100, 120, 3), np.uint8)
        Image.fromarray(pixels).save(folder / f"{number:02}.png")
    return folder


def train(monkeypatch: pytest.MonkeyPatch, *words: object) -> None:
    """Run the command here; what it sets for its own process is set back."""
    monkeypatch.setattr(sys, "argv", ["curriculum", *map(str, words)])
    threads = torch.get_num_threads()
    try:
        command.main()
    finally:
        torch.set_flush_denormal(False)
        torch.set_num_threads(threads)


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_geometry_is_validated_on_held_out_scenes_and_goes_on(
    monkeypatch: pytest.MonkeyPatch, shards: dict[str, Path], tmp_path: Path
) -> None:
    words = (
        *("geometry", "--data", shards["data"], "--held-out", shards["held-out"]),
        *("--out", tmp_path, "--batch", 1, "--validate-every", 2),
    )
    train(monkeypatch, *words, "--steps", 2)
    rows = table(tmp_path / "validation.csv")
    assert [row["step"] for row in rows] == ["0", "2"]
    for row in rows:
        assert 0 < float(row["AbsRel"]) < 3
        assert 0 <= float(row["rotation (deg)"]) <= 180
        assert np.isfinite([float(value) for value in row.values()]).all()
    train(monkeypatch, *words, "--steps", 3)
    assert load_checkpoint(tmp_path / "last.pt")["step"] == 3
    assert [row["step"] for row in table(tmp_path / "validation.csv")] == ["0", "2", "3"]


@pytest.mark.slow
def test_validation_does_not_touch_the_training(
    monkeypatch: pytest.MonkeyPatch, shards: dict[str, Path], tmp_path: Path
) -> None:
    words = ("geometry", "--data", shards["data"], "--batch", 1, "--steps", 2, "--seed", 5)
    held_out = ("--held-out", shards["held-out"], "--validate-every", 1)
    train(monkeypatch, *words, "--out", tmp_path / "plain")
    train(monkeypatch, *words, "--out", tmp_path / "watched", *held_out)
    plain, watched = (
        load_checkpoint(tmp_path / name / "last.pt")["training"] for name in ("plain", "watched")
    )
    assert all(torch.equal(plain[name], watched[name]) for name in plain)


def test_another_size_takes_the_matches_of_its_start_and_leaves_them(
    monkeypatch: pytest.MonkeyPatch, shards: dict[str, Path], tmp_path: Path
) -> None:
    words = ("geometry", "--frozen", "--data", shards["data"], "--batch", 1, "--steps", 1)
    train(monkeypatch, *words, "--out", tmp_path / "mini")
    start = ("--config", "mini-small", "--start", tmp_path / "mini" / "last.pt")
    train(monkeypatch, *words, *start, "--out", tmp_path / "small")
    mini, small = (load_checkpoint(tmp_path / name / "last.pt") for name in ("mini", "small"))
    assert ModelConfig.from_dict(small["config"]).name == "mini-small"
    matching = [n for n in mini["training"] if n.startswith(("backbone.stem.", "matching.flow."))]
    assert matching
    assert all(torch.equal(mini["training"][n], small["training"][n]) for n in matching)


@pytest.mark.parametrize(
    ("frozen", "moves"),
    [((), ("backbone.stem.", "matching.flow.")), (("--frozen",), ("matching.flow.",))],
)
def test_matches_train_without_what_decodes_them(
    monkeypatch: pytest.MonkeyPatch,
    shards: dict[str, Path],
    tmp_path: Path,
    frozen: tuple[str, ...],
    moves: tuple[str, ...],
) -> None:
    words = ("matches", *frozen, "--data", shards["data"], "--batch", 1, "--out", tmp_path)
    train(monkeypatch, *words, "--steps", 0)
    before = load_checkpoint(tmp_path / "last.pt")["training"]
    train(monkeypatch, *words, "--steps", 2)
    after = load_checkpoint(tmp_path / "last.pt")["training"]
    moved = {name for name in before if not torch.equal(before[name], after[name])}
    assert all(name.startswith(moves) for name in moved)
    for part in moves:
        assert any(name.startswith(part) for name in moved), part


def test_steadying_learns_from_its_start_and_leaves_the_codes_of_styles(
    monkeypatch: pytest.MonkeyPatch, shards: dict[str, Path], pictures: Path, tmp_path: Path
) -> None:
    words = (
        *("--data", shards["data"], "--styles", pictures, "--photos", pictures),
        *("--perceptual", __file__, "--batch", 1, "--size", SIZE),
    )
    train(monkeypatch, "style", *words, "--out", tmp_path / "start", "--steps", 1)
    start = tmp_path / "start" / "last.pt"
    steady = ("steady", *words, "--start", start, "--out", tmp_path / "steady")
    train(monkeypatch, *steady, "--steps", 1)
    train(monkeypatch, *steady, "--steps", 3)  # goes on, and still learns from its start
    before, after = (load_checkpoint(p)["model"] for p in (start, tmp_path / "steady" / "last.pt"))
    moved = {name for name in before if not torch.equal(before[name], after[name])}
    assert {name.split(".")[1] for name in moved} == {"content_encoder", "decoder"}
    assert all(name.startswith("strokes.") for name in moved)


@pytest.mark.slow
def test_videos_train_the_whole_network(
    monkeypatch: pytest.MonkeyPatch, videos: Path, tmp_path: Path
) -> None:
    train(
        monkeypatch,
        *("photometric", "--re10k", videos, "--held-out", videos, "--perceptual", __file__),
        *("--out", tmp_path, "--batch", 1, "--size", SIZE, "--steps", 1, "--validate-every", 1),
    )
    config = ModelConfig.from_dict(load_checkpoint(tmp_path / "last.pt")["config"])
    assert config.name == "mini"
    assert float(table(tmp_path / "validation.csv")[0]["photometric"]) > 0


@pytest.mark.parametrize("wikiart", [(), ("--wikiart",)])
def test_styles_are_learnt_on_videos_too(
    monkeypatch: pytest.MonkeyPatch,
    videos: Path,
    pictures: Path,
    tmp_path: Path,
    wikiart: tuple[str, ...],
) -> None:
    train(
        monkeypatch,
        *("style", "--re10k", videos, "--styles", pictures, "--photos", pictures, *wikiart),
        *("--perceptual", __file__, "--out", tmp_path, "--batch", 1, "--size", SIZE, "--steps", 2),
    )
    assert load_checkpoint(tmp_path / "last.pt")["step"] == 2


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("geometry",), "--data"),
        (("novel-views", "--data", "x"), "--perceptual"),
        (("photometric", "--perceptual", "x"), "--re10k or --dl3dv"),
        (("style", "--perceptual", "x", "--data", "x"), "--styles and --photos"),
        (("steady", "--styles", "x", "--photos", "x", "--data", "x"), "--start and --perceptual"),
        (
            ("photometric", "--perceptual", "x", "--re10k", "x", "--frozen"),
            "geometry and novel-views",
        ),
    ],
)
def test_what_a_stage_needs_is_said(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    words: tuple[str, ...],
    told: str,
) -> None:
    with pytest.raises(SystemExit) as ended:
        train(monkeypatch, *words, "--out", tmp_path / "run")
    assert ended.value.code == 2
    assert told in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_what_is_not_there_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "no.pt").write_bytes(b"no checkpoint")
    for option, words in (
        (["--data", "nowhere"], "--data nowhere: there is no such file or folder"),
        (["--data", "empty"], "no scene shards in empty"),
        (["--data", "empty", "--start", "no.pt"], "no.pt"),
    ):
        monkeypatch.chdir(tmp_path)
        with pytest.raises(SystemExit) as exit_info:
            train(monkeypatch, "geometry", *option, "--out", "run")
        assert exit_info.value.code in (2, 3, 4)
        assert words in capsys.readouterr().err.splitlines()[-1]
