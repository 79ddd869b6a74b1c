"""`styl3r reconstruct`: the scene in its own colours, the same as `stylize` at strength 0."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from styl3r_cli import main


def test_it_is_stylize_at_strength_zero(
    tiny_model: Path, photos: list[Path], style: Path, tmp_path: Path
) -> None:
    common = [*map(str, photos), "--model", str(tiny_model), "-q", "-o"]
    assert main.run(["reconstruct", *common, str(tmp_path / "r.ply")]) == 0
    options = ["--style", str(style), "--strength", "0"]
    assert main.run(["stylize", *common, str(tmp_path / "s.ply"), *options]) == 0
    assert (tmp_path / "r.ply").read_bytes() == (tmp_path / "s.ply").read_bytes()


def test_report_and_sheet_have_no_style(
    tiny_model: Path,
    photos: list[Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    sheet = tmp_path / "sheet.png"
    command = ["reconstruct", str(photos[0].parent), "-o", str(tmp_path / "r.ply"), "--json"]
    assert main.run([*command, "--model", str(tiny_model), "--preview", str(sheet)]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["command"] == "reconstruct"
    assert report["styles"] == []
    assert report["strength"] == 0
    picture = np.asarray(Image.open(sheet))
    # Three views and the one between; title, photos, scene and depth.
    assert picture.shape[1] == 2 * 24 + 4 * 256 + 3 * 12
    assert 3 * 256 < picture.shape[0] < 4 * 256


def test_a_style_is_refused(photos: list[Path], tmp_path: Path) -> None:
    command = ["reconstruct", str(photos[0].parent), "-o", str(tmp_path / "r.ply")]
    assert main.run([*command, "--style", "a.jpg"]) == 2
