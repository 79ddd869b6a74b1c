"""`styl3r convert`: every format into every other, files and pipes, and what is said on the way."""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from styl3r_cli import main
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.stored import cameras_from_metadata, cameras_to_metadata
from styl3r_cli.formats import MODULES, encode_scene, read_scene, write_scene
from styl3r_cli.gaussians import Gaussians

Convert = Callable[..., tuple[int, str]]
READABLE = [suffix for suffix in MODULES if suffix != ".points.glb"]


@pytest.fixture
def gaussians() -> Gaussians:
    rng = np.random.default_rng(1)
    rotations = rng.normal(size=(200, 4))
    return Gaussians(
        means=rng.uniform(-2, 2, (200, 3)),
        scales=rng.uniform(0.01, 0.1, (200, 3)),
        rotations=rotations / np.linalg.norm(rotations, axis=1, keepdims=True),
        opacities=rng.uniform(0.2, 1, 200),
        colours=rng.uniform(0, 1, (200, 3)),
    )


@pytest.fixture
def metadata() -> dict[str, str]:
    return cameras_to_metadata([Camera(np.eye(4), 100.0, 100.0, 50.0, 40.0, 100, 80)])


@pytest.fixture
def convert(capsys: pytest.CaptureFixture[str]) -> Convert:
    def run(*arguments: object) -> tuple[int, str]:
        code = main.run(["convert", *map(str, arguments)])
        out, err = capsys.readouterr()
        assert out == ""
        return code, err

    return run


@pytest.mark.parametrize("source", READABLE)
@pytest.mark.parametrize("target", MODULES)
def test_every_format_into_every_other(
    convert: Convert, gaussians: Gaussians, tmp_path: Path, source: str, target: str
) -> None:
    write_scene(tmp_path / f"a{source}", gaussians)
    code, err = convert(tmp_path / f"a{source}", tmp_path / f"b{target}")
    assert code == 0, err
    if target in READABLE:
        back = read_scene(tmp_path / f"b{target}").gaussians
        assert len(back) == 200
        for one, other in ((back, gaussians), (gaussians, back)):  # both ways: orders differ
            away = np.abs(one.means[:, None] - other.means[None]).max(axis=2).min(axis=1)
            assert away.max() < 0.005
        np.testing.assert_allclose(
            np.sort(back.opacities), np.sort(gaussians.opacities), atol=0.005
        )


def test_what_is_lost_is_said_once_and_quiet_says_nothing(
    convert: Convert, gaussians: Gaussians, metadata: dict[str, str], tmp_path: Path
) -> None:
    write_scene(tmp_path / "a.ply", gaussians, metadata)
    code, err = convert(tmp_path / "a.ply", tmp_path / "a.splat")
    lines = err.splitlines()
    assert code == 0
    assert len(lines) == 2
    assert all(line.startswith("styl3r: ") for line in lines)
    assert "rounds colours, opacities and rotations to 8 bits" in lines[0]
    assert "no place for cameras: 1 are left out" in lines[1]
    assert convert(tmp_path / "a.ply", tmp_path / "a.splat", "-q") == (0, "")
    assert convert(tmp_path / "a.ply", tmp_path / "a.glb") == (0, "")


def test_cameras_go_from_format_to_format(
    convert: Convert, gaussians: Gaussians, metadata: dict[str, str], tmp_path: Path
) -> None:
    write_scene(tmp_path / "0.ply", gaussians, metadata)
    names = ["0.ply", "1.glb", "2.sog", "3.compressed.ply", "4.ply"]
    for source, target in pairwise(names):
        assert convert(tmp_path / source, tmp_path / target, "-q") == (0, "")
    assert cameras_from_metadata(read_scene(tmp_path / "4.ply").metadata)[0].width == 100


def test_view_dependent_colours_are_said_to_be_lost(
    convert: Convert, gaussians: Gaussians, tmp_path: Path
) -> None:
    data = encode_scene(gaussians).data
    head, body = data.split(b"end_header\n")
    rows = np.frombuffer(body, "<f4").reshape(200, 17)
    more = np.column_stack([rows, np.ones(200)]).astype("<f4").tobytes()
    foreign = head + b"property float f_rest_0\nend_header\n" + more
    (tmp_path / "a.ply").write_bytes(foreign)
    code, err = convert(tmp_path / "a.ply", tmp_path / "b.ply")
    assert (code, err) == (0, "styl3r: view-dependent colours (f_rest) are ignored\n")


def test_formats_may_be_said_whatever_the_names(
    convert: Convert, gaussians: Gaussians, tmp_path: Path
) -> None:
    (tmp_path / "scene.bin").write_bytes(encode_scene(gaussians, suffix=".splat").data)
    options = ("--from", "splat", "--to", "spz")
    code, _ = convert(tmp_path / "scene.bin", tmp_path / "out", *options)
    assert code == 0
    assert len(read_scene((tmp_path / "out").read_bytes(), ".spz").gaussians) == 200


def test_a_line_of_pipes(gaussians: Gaussians, metadata: dict[str, str]) -> None:
    data = encode_scene(gaussians, metadata).data
    for kind in ("sog", "glb", "compressed.ply", "spz", "splat", "ply"):
        command = [sys.executable, "-m", "styl3r_cli", "convert", "-", "-", "--to", kind]
        done = subprocess.run(command, input=data, capture_output=True, check=False, timeout=60)
        assert done.returncode == 0, done.stderr
        data = done.stdout
    assert len(read_scene(data, ".ply").gaussians) == 200


def test_failures_are_one_line_and_leave_nothing(
    convert: Convert, gaussians: Gaussians, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = tmp_path / "a.ply"
    write_scene(scene, gaussians)
    (tmp_path / "cut.spz").write_bytes(encode_scene(gaussians, suffix=".spz").data[:500])
    (tmp_path / "points.points.glb").write_bytes(encode_scene(gaussians, suffix=".points.glb").data)
    before = sorted(tmp_path.iterdir())
    for arguments, code, words in (
        ((scene, tmp_path / "b.obj"), 2, "unknown scene format '.obj'"),
        ((tmp_path / "a.obj", tmp_path / "b.ply"), 2, "unknown scene format '.obj'"),
        ((scene, scene), 2, "is also an input"),
        ((scene, tmp_path / "b.ply", "--to", "obj"), 2, "'obj' is not one of"),
        ((tmp_path / "gone.ply", tmp_path / "b.ply"), 3, "cannot be read: No such file"),
        ((tmp_path / "cut.spz", tmp_path / "b.ply"), 3, "cut off"),
        ((scene, tmp_path / "b.ply", "--from", "sog"), 3, "not a .sog file"),
        ((tmp_path / "points.points.glb", tmp_path / "b.ply"), 3, "not a scene"),
        ((scene, tmp_path / "no" / "b.ply"), 6, "does not exist"),
    ):
        got, err = convert(*arguments)
        assert (got, err.count("\n")) == (code, 1), err
        assert words in err
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"neither this nor that")))
    code, err = convert("-", tmp_path / "b.ply")
    assert code == 3
    assert "not a scene in a known format" in err
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("suffix", [".splat", ".spz", ".sog", ".compressed.ply", ".glb"])
def test_new_scenes_have_the_format_that_their_name_says(
    run: Callable[..., tuple[int, bytes, str]],
    photos: list[Path],
    style: Path,
    tmp_path: Path,
    suffix: str,
) -> None:
    target = tmp_path / f"scene{suffix}"
    code, _, err = run("stylize", *photos, "--style", style, "-o", target)
    assert code == 0, err
    scene = read_scene(target)
    assert len(scene.gaussians) > 0
    kept = len(cameras_from_metadata(scene.metadata)) == len(photos)
    assert kept != ("no place for cameras: 3 are left out" in err)
