"""`styl3r compact`: from files to files, what it says, and what it refuses."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from styl3r_cli import main
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.stored import cameras_from_metadata, cameras_to_metadata
from styl3r_cli.commands.compact import BytesType
from styl3r_cli.formats import read_scene, write_scene
from styl3r_cli.gaussians import Gaussians

Compact = Callable[..., tuple[int, str, str]]
SIDE = 24


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A wall of one colour, one Gaussian a pixel, twice."""
    y, x = (np.mgrid[:SIDE, :SIDE] + 0.5) / SIDE - 0.5
    once = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3)
    means = np.concatenate([once, once * 1.01])
    count = len(means)
    gaussians = Gaussians(
        means,
        np.full((count, 3), 0.7 / SIDE),
        np.tile([1.0, 0, 0, 0], (count, 1)),
        np.full(count, 0.95),
        np.tile([0.7, 0.5, 0.2], (count, 1)),
    )
    camera = Camera(np.eye(4), SIDE, SIDE, SIDE / 2, SIDE / 2, SIDE, SIDE)
    path = tmp_path / "scene.ply"
    write_scene(path, gaussians, cameras_to_metadata([camera]))
    return path


@pytest.fixture
def compact(capsys: pytest.CaptureFixture[str]) -> Compact:
    def run(*arguments: object) -> tuple[int, str, str]:
        capsys.readouterr()
        code = main.run(["compact", *map(str, arguments)])
        out, err = capsys.readouterr()
        return code, out, err

    return run


def test_a_budget_and_its_report(scene: Path, tmp_path: Path, compact: Compact) -> None:
    out = tmp_path / "small.ply"
    code, printed, told = compact(scene, "-o", out, "--max-gaussians", 100, "--json")
    assert code == 0, told
    report = json.loads(printed)
    assert report["gaussians"] == {"before": 2 * SIDE * SIDE, "after": 100}
    assert report["bytes"]["after"] == out.stat().st_size
    assert report["worst_db"] <= report["mean_db"]
    assert "100 of 1,152 Gaussians kept (8.7 %)" in told
    written = read_scene(out)
    assert len(written.gaussians) == 100
    assert len(cameras_from_metadata(written.metadata)) == 1


def test_a_file_as_small_as_asked_for(scene: Path, tmp_path: Path, compact: Compact) -> None:
    out = tmp_path / "small.splat"
    assert compact(scene, "-o", out, "--max-bytes", "8kB", "-q")[0] == 0
    assert 6000 < out.stat().st_size <= 8000


def test_more_bytes_than_any_float_are_no_limit(
    scene: Path, tmp_path: Path, compact: Compact
) -> None:
    code, _, told = compact(scene, "-o", tmp_path / "a.splat", "--max-bytes", f"1{'0' * 400}kB")
    assert code == 0, told


def test_decibels_that_were_asked_for_are_kept(
    scene: Path, tmp_path: Path, compact: Compact
) -> None:
    code, printed, _ = compact(scene, "-o", tmp_path / "a.ply", "--keep-db", 30, "--json")
    report = json.loads(printed)
    assert code == 0
    assert report["worst_db"] >= 30
    assert report["kept"] <= 1


def test_all_keeps_all(scene: Path, tmp_path: Path, compact: Compact) -> None:
    out = tmp_path / "all.ply"
    assert compact(scene, "-o", out, "--all")[0] == 0
    assert out.read_bytes() == scene.read_bytes()


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (["--keep-db", "40", "--max-gaussians", "9"], 2, "exclude each other"),
        (["--max-bytes", "five"], 2, "not a size"),
        (["--max-bytes", "10"], 2, "as small as 10 bytes"),
        (["--cameras", "nowhere.json"], 3, "nowhere.json"),
    ],
)
def test_what_is_refused(
    scene: Path, tmp_path: Path, compact: Compact, options: list[str], code: int, said: str
) -> None:
    out = tmp_path / "out.ply"
    ended, _, told = compact(scene, "-o", out, *options)
    assert ended == code
    assert said in told
    assert told.count("\n") == 1
    assert not out.exists()


def test_the_scene_is_never_overwritten(scene: Path, compact: Compact) -> None:
    before = scene.read_bytes()
    assert compact(scene, "-o", scene)[0] == 2
    assert scene.read_bytes() == before


@pytest.mark.parametrize(
    ("text", "size"), [("500", 500), ("5MB", 5_000_000), ("1.5 kB", 1500), ("2MiB", 2 << 20)]
)
def test_sizes_as_people_write_them(text: str, size: int) -> None:
    assert BytesType().convert(text, None, None) == size


def test_damaged_cameras_are_told_once(scene: Path, tmp_path: Path, compact: Compact) -> None:
    scene.write_bytes(scene.read_bytes().replace(b"camera.0: 24 ", b"camera.0: 24.5 "))
    code, _, told = compact(scene, "-o", tmp_path / "x.ply", "--max-gaussians", 100)
    assert code == 0
    assert told.count("styl3r: the scene's cameras are damaged and ignored\n") == 1
