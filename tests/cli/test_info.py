"""`styl3r info`: what it tells of a scene, for people and for scripts."""

from __future__ import annotations

import io
import json
import struct
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from styl3r_cli import main
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.stored import cameras_to_metadata
from styl3r_cli.formats import MODULES, encode_scene, write_scene
from styl3r_cli.gaussians import Gaussians

Info = Callable[..., tuple[int, str, str]]
METADATA = {
    "generator": "styl3r 0.1",
    **cameras_to_metadata([Camera(np.eye(4), 90.0, 91.0, 50.0, 40.0, 100, 80)] * 2),
}


@pytest.fixture
def gaussians() -> Gaussians:
    rng = np.random.default_rng(1)
    return Gaussians(
        means=rng.uniform([-1, -2, 3], [1, 2, 5], (101, 3)),
        scales=rng.uniform(0.01, 0.1, (101, 3)),
        rotations=np.tile([1.0, 0, 0, 0], (101, 1)),
        opacities=rng.uniform(0.2, 1, 101),
        colours=rng.uniform(0, 1, (101, 3)),
    )


@pytest.fixture
def info(capsys: pytest.CaptureFixture[str]) -> Info:
    def run(*arguments: object) -> tuple[int, str, str]:
        code = main.run(["info", *map(str, arguments)])
        out, err = capsys.readouterr()
        return code, out, err

    return run


def test_the_report_is_what_numpy_says(info: Info, gaussians: Gaussians, tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    write_scene(path, gaussians, METADATA)
    code, out, err = info(path, "--json")
    assert (code, err) == (0, "")
    report = json.loads(out)
    assert (report["path"], report["format"]) == (str(path), ".ply")
    assert (report["gaussians"], report["bytes"]) == (101, path.stat().st_size)
    assert set(report["non_finite"].values()) == {0}
    np.testing.assert_allclose(report["bounds"]["least"], gaussians.means.min(axis=0))
    np.testing.assert_allclose(report["bounds"]["most"], gaussians.means.max(axis=0))
    for key, values in {
        "y": gaussians.means[:, 1],
        "scale": gaussians.scales,
        "opacity": gaussians.opacities,
        "blue": gaussians.colours[:, 2],
    }.items():
        found = [report["ranges"][key][end] for end in ("least", "middle", "most")]
        np.testing.assert_allclose(found, np.quantile(values, [0, 0.5, 1]), rtol=1e-5)
    assert [camera["fy"] for camera in report["cameras"]] == [91, 91]
    assert report["cameras"][0]["extrinsics"] == np.eye(4).tolist()
    assert report["metadata"] == {"generator": "styl3r 0.1"}


def test_sizes_are_those_of_the_files(info: Info, gaussians: Gaussians, tmp_path: Path) -> None:
    write_scene(tmp_path / "a.ply", gaussians, METADATA)
    sizes = json.loads(info(tmp_path / "a.ply", "--json")[1])["sizes"]
    assert sizes[".ply"] == (tmp_path / "a.ply").stat().st_size
    assert list(sizes) == list(MODULES)
    for suffix, size in sizes.items():
        write_scene(tmp_path / f"b{suffix}", gaussians, METADATA)
        assert abs((tmp_path / f"b{suffix}").stat().st_size - size) <= 0.01 * size
    assert "sizes" not in json.loads(info(tmp_path / "a.ply", "--json", "--no-sizes")[1])


def test_the_table_is_for_people(info: Info, gaussians: Gaussians, tmp_path: Path) -> None:
    write_scene(tmp_path / "a.sog", gaussians, METADATA)
    code, out, err = info(tmp_path / "a.sog")
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert lines[0].endswith("a.sog: .sog, 0.01 MB, 101 Gaussians")
    rows = {line.split()[0]: line.split()[1:] for line in lines if line.strip()}
    assert [float(word) for word in rows["z"]] == pytest.approx(
        np.quantile(gaussians.means[:, 2], [0, 0.5, 1]), abs=1e-3
    )
    assert rows["not"] == ["finite", "none"]
    assert rows["cameras"] == ["2", "(100x80)"]
    assert rows["generator"] == ["styl3r", "0.1"]
    assert rows[".splat"] == ["0.00", "MB", "32.0", "bytes", "a", "Gaussian"]


def test_values_that_are_not_finite_are_counted(
    info: Info, gaussians: Gaussians, tmp_path: Path
) -> None:
    data = encode_scene(gaussians).data
    head, body = data[: -101 * 68], bytearray(data[-101 * 68 :])
    body[:4] = body[68:72] = struct.pack("<f", np.nan)  # two x
    body[36:40] = struct.pack("<f", np.nan)  # and the opacity of the first
    (tmp_path / "a.ply").write_bytes(head + bytes(body))
    code, out, err = info(tmp_path / "a.ply", "--no-sizes")
    assert code == 0
    assert err == "styl3r: 2 of 101 Gaussians were not finite and left out\n"
    assert "not finite  2 Gaussians (2 in means, 1 in opacities)" in out
    report = json.loads(info(tmp_path / "a.ply", "--json", "-q")[1])
    assert report["non_finite"] == {
        "gaussians": 2,
        "means": 2,
        "scales": 0,
        "rotations": 0,
        "opacities": 1,
        "colours": 0,
    }
    assert report["gaussians"] == 99


def test_a_scene_of_nothing_and_a_pipe(
    info: Info, gaussians: Gaussians, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_scene(tmp_path / "a.ply", gaussians.select(np.zeros(101, bool)))
    code, out, _ = info(tmp_path / "a.ply", "--json")
    report = json.loads(out)
    assert (code, report["gaussians"], report["bounds"]) == (0, 0, None)
    assert report["ranges"]["x"] is None
    assert info(tmp_path / "a.ply")[0] == 0
    piped = encode_scene(gaussians, METADATA, ".spz").data
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(piped)))
    report = json.loads(info("-", "--json", "--no-sizes")[1])
    assert (report["path"], report["format"], report["bytes"]) == ("-", ".spz", len(piped))


def test_failures_are_one_line(info: Info, tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(b"glTF and no more")
    for name, code in (("a.glb", 3), ("b.glb", 3), ("a.jpg", 2)):
        got, out, err = info(tmp_path / name)
        assert (got, out, err.count("\n")) == (code, "", 1)
