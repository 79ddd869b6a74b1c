"""`styl3r bench render`: what it times, prints and writes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from styl3r_cli.commands.bench import command
from styl3r_cli.errors import InputError, UsageError
from styl3r_cli.formats import write_scene
from styl3r_cli.splatting import ray_traced, render, timing


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


def test_mitsuba_stands_beside_it_or_a_note_says_why_not(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    path = tmp_path / "times.json"
    result = bench("--gaussians", 300, "--sizes", 24, "--repeats", 2, "--json", path)
    assert result.exit_code == 0, result.output
    rows = [r for r in json.loads(path.read_text())["rows"] if r["renderer"] == "Mitsuba 3"]
    if "without Mitsuba 3: " in result.stderr:  # LLVM is none of pip's
        assert rows == []
        pytest.skip("no LLVM that suits Mitsuba")
    assert [row["repeats"] for row in rows] == [2]
    assert rows[0]["milliseconds"] > 0


def test_a_mitsuba_that_fails_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mitsuba.py").write_text("raise ImportError('no LLVM here')\n")
    (tmp_path / "drjit.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    result = bench("--gaussians", 50, "--sizes", "16", "--threads", 1, "--repeats", 1)
    assert result.exit_code == 0, result.output
    assert "without Mitsuba 3: ImportError: no LLVM here" in result.stderr
    assert "Mitsuba" not in result.stdout


def test_mitsuba_draws_the_same_picture(tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    scene, camera = timing.synthetic_scene(2000), timing.camera_of(96, 64)
    np.savez(
        tmp_path / "in.npz",
        **{name: getattr(scene, name) for name in ray_traced.GAUSSIANS},
        view=camera.extrinsics,
    )
    code = f"""
import mitsuba, numpy as np
mitsuba.set_variant("{ray_traced.VARIANT}")
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.splatting.ray_traced import GAUSSIANS, draw, to_mitsuba
file = np.load("in.npz")
scene = Gaussians(*(file[name] for name in GAUSSIANS))
np.save("out.npy", draw(to_mitsuba(scene, file["view"], {camera.fx}, 96, 64), rays=64))
"""
    child = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=False)
    if child.returncode:
        pytest.skip("no LLVM that suits Mitsuba")
    drawn = np.load(tmp_path / "out.npy")
    ours = render(scene, camera).colour
    mirrored = [np.abs(drawn - other).mean() for other in (ours[::-1], ours[:, ::-1])]
    # Its Gaussians are not flattened onto the picture and not blurred: alike, but not the same.
    assert np.abs(drawn - ours).mean() < 0.4 * min(mirrored)


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


@pytest.mark.parametrize("count", [2**31, 10**400])
def test_more_gaussians_than_memory_holds_are_refused(count: int) -> None:
    result = bench("--gaussians", count, "--sizes", 16, "--twin-seconds", 0)
    assert result.exit_code == 2, result.exception
    assert "not in the range" in result.stderr


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
