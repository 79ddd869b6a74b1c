"""`styl3r bench render`: what it times, prints and writes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from styl3r_cli.commands.bench import command
from styl3r_cli.errors import InputError, UsageError
from styl3r_cli.formats import write_scene
from styl3r_cli.splatting import render, timing


def bench(*arguments: object) -> Result:
    return CliRunner().invoke(command, ["render", *map(str, arguments)])


def test_a_table_and_the_same_as_json(tmp_path: Path) -> None:
    path = tmp_path / "times.json"
    result = bench(
        "--gaussians", "50,100", "--sizes", "16,32x8", "--threads", "1,2", "--repeats", 3,
        "--twin-seconds", 0, "--json", path,
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    report = json.loads(path.read_text())
    cases = {(r["gaussians"], r["width"], r["height"], r["threads"]) for r in report["rows"]}
    assert len(cases) == len(report["rows"]) == 8
    assert (100, 32, 8, 2) in cases
    for row in report["rows"]:
        assert row["repeats"] == 3
        assert row["fps"] == pytest.approx(1000 / row["milliseconds"])
        assert 0 < row["fastest_milliseconds"] <= row["milliseconds"]
    assert report["machine"]["cores"] >= 1
    lines = result.stdout.splitlines()
    assert len(lines) == 9
    assert "32x8" in result.stdout


def test_a_profile_adds_up_to_the_frame(tmp_path: Path) -> None:
    path = tmp_path / "times.json"
    result = bench(
        "--gaussians", 20000, "--sizes", "16,512", "--threads", 1, "--repeats", 5,
        "--twin-seconds", 0, "--profile", "--json", path,
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    small, large = json.loads(path.read_text())["rows"]
    for row in (small, large):
        assert all(milliseconds > 0 for milliseconds in row["stages"].values())
        # Other frames of the same case, on a machine that may be busy.
        whole = sum(row["stages"].values()) / row["milliseconds"]
        assert 0.2 < whole < 5
    # A thousand times as many pixels are what blending pays for, and projection does not.
    growth = {name: large["stages"][name] / small["stages"][name] for name in small["stages"]}
    assert growth["blending"] > 3 * growth["projection"]
    assert all(name in result.stdout for name in small["stages"])


def test_the_twin_stands_beside_it(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    path = tmp_path / "times.json"
    once = ("--gaussians", 300, "--repeats", 1)
    result = bench(*once, "--sizes", 24, "--threads", 1, "--json", path)
    assert result.exit_code == 0, result.output
    rows = json.loads(path.read_text())["rows"]
    assert [(row["renderer"], row["foretold"]) for row in rows] == [
        ("styl3r", False), ("torch twin", False),
    ]  # fmt: skip
    result = bench(*once, "--sizes", 999, "--twin-seconds", 1e-9)
    assert result.exit_code == 0, result.output
    assert "~" in result.stdout.splitlines()[-1]


def test_a_scene_of_ones_own(tmp_path: Path) -> None:
    path, out = tmp_path / "scene.ply", tmp_path / "times.json"
    write_scene(path, timing.synthetic_scene(80), {})
    arguments = ("--sizes", 16, "--threads", 1, "--twin-seconds", 0, "--json", out)
    assert bench(path, *arguments).exit_code == 0
    assert [row["gaussians"] for row in json.loads(out.read_text())["rows"]] == [80]
    assert bench(path, "--gaussians", "20,80", *arguments).exit_code == 0
    assert [row["gaussians"] for row in json.loads(out.read_text())["rows"]] == [20, 80]
    assert isinstance(bench(path, "--gaussians", 81, *arguments).exception, UsageError)
    assert isinstance(bench(tmp_path / "none.ply", *arguments).exception, InputError)


@pytest.mark.parametrize(
    "arguments", [("--sizes", "0"), ("--gaussians", "1,x"), ("--threads", "0"), ("--repeats", "0")]
)
def test_nonsense_is_refused(arguments: tuple[str, str]) -> None:
    assert bench(*arguments).exit_code == 2


@pytest.mark.parametrize("count", [1, 2, 7, 5000])
def test_the_scene_is_the_same_every_time_and_fills_the_frame(count: int) -> None:
    scene = timing.synthetic_scene(count)
    assert len(scene) == count
    again = timing.synthetic_scene(count)
    for name in ("means", "scales", "rotations", "opacities", "colours"):
        np.testing.assert_array_equal(getattr(again, name), getattr(scene, name))
    frame = render(scene, timing.camera_of(64, 64))
    assert frame.invalid == 0
    if count == 5000:
        assert np.mean(frame.alpha > 0.9) > 0.8


@pytest.mark.slow
def test_the_first_frame_of_a_process_is_compiled_anew() -> None:
    assert 0.2 < timing.seconds_to_first_frame() < 120
