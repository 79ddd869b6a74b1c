"""`styl3r tradeoff` beside what is known to be true: held-out photos, cameras, depths."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation
from tiny_model import BASELINE, parse_graph

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.transforms import write_transforms

Run = Callable[..., tuple[int, bytes, str]]
UNIT = 7.0  # of the given cameras' world
# One point, measured once.
ONE = (
    *("--precisions", "fp32", "--sizes", "64", "--budgets", "100", "--drawings", "exact"),
    *("--colours", "fitted", "--repeats", 1),
)
# Mean squared error has the signature of LPIPS, and its values are known from PSNR.
DISTANCE = """
<ir_version: 10, opset_import: ["" : 18]>
distance (float[{shape}] {image}, float[{shape}] reference) => (float[{count}] {distance})
{{
  off = Sub ({image}, reference)
  square = {square}
  all = Constant <value_ints = [{axes}]> ()
  {distance} = ReduceMean <keepdims = 0> (square, all)
}}
"""
PARTS = {"shape": "1,3,H,W", "image": "image", "distance": "distance", "count": "1"}
PARTS |= {"square": "Mul (off, off)", "axes": "1, 2, 3"}


@pytest.fixture
def write_graph(tmp_path: Path) -> Callable[..., Path]:
    """Writes DISTANCE, with other parts where they are given."""

    def write(**parts: str) -> Path:
        path = tmp_path / "net.onnx"
        model = parse_graph(DISTANCE.format(**PARTS | parts))
        path.write_bytes(model.SerializeToString())
        return path

    return write


def test_held_out_photos_are_the_truth(
    measure: Run, here: list[dict[str, Any]], photos: list[Path], tmp_path: Path
) -> None:
    code, _, err = measure(
        *(*photos[:2], "--holdout", photos[2], "-o", tmp_path / "r", "--precisions", "fp32"),
        *("--sizes", "64", "--budgets", "100", "--drawings", "exact", "--repeats", 1),
        *("--colours", "fitted"),
    )
    assert code == 0, err
    report = json.loads((tmp_path / "r" / "tradeoff.json").read_text())
    assert here[0]["photos"] == [str(path) for path in photos[:2]]
    assert 0 < report["points"][0]["truth_psnr"] < 50


def write_cameras(path: Path, photos: list[Path], turns: list[float], pushes: list[float]) -> None:
    """The tiny model's cameras, each turned and moved along y, in another world and unit."""
    world = np.eye(4)
    world[:3, :3] = Rotation.from_rotvec([0.3, -1.2, 0.5]).as_matrix()
    world[:3, 3] = 4, -5, 6
    cameras = []
    for index, (turn, push) in enumerate(zip(turns, pushes, strict=True)):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("y", turn, degrees=True).as_matrix()
        pose[:3, 3] = -UNIT * (pose[:3, :3] @ [BASELINE * index, push, 0])
        cameras.append(Camera(pose @ world, 80.0, 80.0, 48.0, 40.0, 96, 80))
    write_transforms(path, cameras, [photo.name for photo in photos])


def test_given_cameras_are_the_truth_in_any_world_and_unit(
    measure: Run, here: list[dict[str, Any]], photos: list[Path], tmp_path: Path
) -> None:
    """The second camera is right, the third stands 45 degrees off, and is turned by 8 more."""
    # Of the motion as the third camera sees it: its turn takes it out of the plane of the 45.
    direction = np.degrees(np.arccos(np.cos(np.radians(8)) * np.cos(np.radians(45))))
    cameras = tmp_path / "cameras.json"
    plain = ("-o", tmp_path / "r", "--precisions", "fp32", "--sizes", "64", "--budgets", "100")
    plain = (*plain, "--drawings", "exact", "--repeats", 1, "--colours", "fitted")
    plain = (*plain, "--cameras", cameras, "--views", "3,2")
    write_cameras(cameras, photos, [0, 0, 8], [0, 0, 2 * BASELINE])
    code, out, err = measure(*photos, *plain)
    assert code == 0, err
    report = json.loads((tmp_path / "r" / "tradeoff.json").read_text())
    for point, wrong in zip(report["points"], (0.5, 0), strict=True):  # the median of two, of one
        assert point["camera_rotation_degrees"] == pytest.approx(8 * wrong, abs=0.5)
        assert point["camera_direction_degrees"] == pytest.approx(direction * wrong, abs=0.5)
    assert re.search(r"\d,.*°", out.decode())
    assert "°" in (tmp_path / "r" / "index.html").read_text()

    write_cameras(cameras, photos, [0, 0, 0], [0, 0, 0])
    assert measure(*photos, *plain)[0] == 0
    assert len(here) == 4  # another file is another input
    report = json.loads((tmp_path / "r" / "tradeoff.json").read_text())
    assert report["points"][0]["camera_direction_degrees"] < 0.5

    write_cameras(cameras, photos[1:], [0, 0], [0, 0])
    code, _, err = measure(*photos, *plain)
    assert (code, "relative to the first photo" in err) == (3, True), err
    assert len(here) == 4


def test_lpips_of_held_out_photos_is_what_the_graph_says(
    measure: Run,
    here: list[dict[str, Any]],
    photos: list[Path],
    tmp_path: Path,
    write_graph: Callable[..., Path],
) -> None:
    target = tmp_path / "r"
    plain = (*photos[:2], "--holdout", photos[2], "-o", target, *ONE)
    code, out, err = measure(*plain, "--lpips", write_graph())
    assert code == 0, err
    point = json.loads((target / "tradeoff.json").read_text())["points"][0]
    assert point["truth_lpips"] == pytest.approx(10 ** (-point["truth_psnr"] / 10), rel=1e-4)
    with (target / "tradeoff.csv").open() as file:
        assert float(next(csv.DictReader(file))["truth_lpips"]) == point["truth_lpips"]
    shown = f"{point['truth_lpips']:.3f}"
    table = [line.split() for line in out.decode().splitlines()]
    assert "LPIPS" in table[0]
    assert table[1][-1] == shown
    page = (target / "index.html").read_text()
    assert "<th>LPIPS" in page
    assert f"<td>{shown}<td>" in page

    assert measure(*plain)[0] == 0
    assert len(here) == 1  # what was measured before serves both
    for name in ("index.html", "tradeoff.csv", "tradeoff.json"):
        text = (target / name).read_text()
        assert "truth_lpips" not in text
        assert "<th>LPIPS" not in text


@pytest.mark.parametrize(
    ("parts", "told"),
    [
        ({"image": "picture"}, "no input 'image'"),
        ({"distance": "far"}, "no output 'distance'"),
        ({"shape": "3,H,W", "axes": "1, 2", "count": "3"}, "rank 3, expected a tensor(float)"),
        ({"shape": "1,3,32,32"}, "the graph failed"),
        ({"square": "Cos (off)"}, "it is 1 for equal pictures"),
        ({"axes": "0, 2, 3", "count": "3"}, "3 distances"),
    ],
)
def test_other_graphs_are_no_lpips(
    measure: Run,
    photos: list[Path],
    tmp_path: Path,
    write_graph: Callable[..., Path],
    parts: dict[str, str],
    told: str,
) -> None:
    graph = write_graph(**parts)
    held_out = (*photos[:2], "--holdout", photos[2], "-o", tmp_path / "r", *ONE)
    code, _, err = measure(*held_out, "--lpips", graph)
    assert (code, told in err, err.count("\n")) == (4, True, 1), err
    assert not (tmp_path / "r").exists()


def test_lpips_needs_a_graph_and_something_to_compare_with(
    measure: Run, photos: list[Path], tmp_path: Path, write_graph: Callable[..., Path]
) -> None:
    target = ("-o", tmp_path / "r", *ONE)
    held_out = ("--holdout", photos[2], "--lpips", write_graph(), "--sizes", 16)
    code, _, err = measure(*photos[:2], *target, *held_out)
    assert (code, "31 pixels" in err) == (2, True), err
    code, _, err = measure(*photos, *target, "--lpips", photos[0])
    assert (code, "--holdout" in err) == (2, True), err
    for path in (photos[0], tmp_path / "none.onnx"):
        code, _, err = measure(*photos[:2], "--holdout", photos[2], *target, "--lpips", path)
        assert (code, "cannot be loaded" in err, err.count("\n")) == (4, True, 1), err
    assert not (tmp_path / "r").exists()


def write_depths(cameras: Path, photos: list[Path], factors: list[float]) -> list[Path]:
    """The tiny model's depths times factors, in millimetres of the cameras' world, beside them.

    The first is half the photo's resolution and not known everywhere, the second an array.
    """
    write_cameras(cameras, photos, [0] * len(photos), [0] * len(photos))
    paths = []
    for index, (photo, factor) in enumerate(zip(photos, factors, strict=True)):
        with Image.open(photo) as picture:
            depth = 2 + np.asarray(picture).mean(axis=2) / 255
        depth *= factor * UNIT * 1000
        if index == 1:
            paths.append(cameras.with_name("1.npy"))
            np.save(paths[-1], depth.astype(np.float32))
            continue
        if index == 0:
            depth = depth.reshape(40, 2, 48, 2).mean(axis=(1, 3))
            depth[:, 24:] = 0
        paths.append(cameras.with_name(f"{index}.png"))
        Image.fromarray(depth.round().astype(np.uint16)).save(paths[-1])
    content = json.loads(cameras.read_text())
    for frame, path in zip(content["frames"], paths, strict=True):
        frame["depth_file_path"] = path.name
    cameras.write_text(json.dumps(content))
    return paths


def test_named_depths_are_the_truth_in_any_unit(
    measure: Run, here: list[dict[str, Any]], photos: list[Path], tmp_path: Path
) -> None:
    """The third view's depths are half as large again; of two views, all are right."""
    cameras, target = tmp_path / "cameras.json", tmp_path / "r"
    write_depths(cameras, photos, [1, 1, 1.5])
    plain = (*photos, "-o", target, "--cameras", cameras, *ONE)
    plain = (*plain, "--sizes", "64,48", "--views", "3,2")
    code, out, err = measure(*plain)
    assert code == 0, err
    points = json.loads((target / "tradeoff.json").read_text())["points"]
    errors = {(p["size"], p["views"]): p["depth_absrel"] for p in points}
    # Medians of a view that is not known on one side, and of what the crop leaves of the others.
    seen = [np.asarray(Image.open(photo)).mean(axis=2)[:, 8:88] / 255 + 2 for photo in photos]
    seen[0] = seen[0][:, :40]
    true = np.concatenate([seen[0].ravel(), seen[1].ravel(), 1.5 * seen[2].ravel()])
    scale = np.median(true) / np.median(np.concatenate([each.ravel() for each in seen]))
    assert 1.01 < scale < 1.2
    assert errors[64, 3] == pytest.approx(scale - 1, abs=0.01)
    assert errors[48, 3] == pytest.approx(scale - 1, abs=0.01)
    assert errors[64, 2] < 0.01
    assert [p["depth_within_25_percent"] for p in points] == [1, 1, 1]  # of two views in three
    assert f"{errors[64, 3]:.3f}, 100%" in out.decode()
    assert "<th>depth" in (target / "index.html").read_text()

    write_depths(cameras, photos, [1, 1.5, 1.5])
    assert measure(*plain)[0] == 0
    assert len(here) == 3  # what was measured is compared with other depths
    points = json.loads((target / "tradeoff.json").read_text())["points"]
    assert [p["depth_absrel"] > 0.1 for p in points if p["views"] == 2] == [True]


def test_depths_that_are_none_are_refused(
    measure: Run, here: list[dict[str, Any]], photos: list[Path], tmp_path: Path
) -> None:
    cameras, target = tmp_path / "cameras.json", tmp_path / "r"
    plain = (*photos, "-o", target, "--cameras", cameras, *ONE)
    first, second, third = write_depths(cameras, photos, [1, 1, 1])
    third.unlink()
    code, _, err = measure(*plain)
    assert (code, f"{third}: cannot be read: No such file" in err) == (3, True), err
    Image.new("L", (96, 80), 200).save(third)
    code, _, err = measure(*plain)
    assert (code, f"{third}: no depth picture" in err, err.count("\n")) == (3, True, 1), err
    Image.fromarray(np.ones((96, 80), np.uint16)).save(third)
    code, _, err = measure(*plain)
    assert (code, f"{third}: 80x96 pixels are another shape" in err) == (3, True), err
    assert not target.exists()

    for path in (first, third):
        Image.fromarray(np.zeros((80, 96), np.uint16)).save(path)
    np.save(second, np.full((80, 96), np.nan, np.float32))
    code, _, err = measure(*plain, "--views", 2)
    assert (code, err.count("knows no depth")) == (0, 3), err
    assert "depth" not in (target / "tradeoff.csv").read_text()
    assert [job["depths"] for job in here] == [False]


def test_held_out_photos_that_cannot_be_are_refused_before_models_are_made(
    measure: Run, photos: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(photos[0].parent)
    for held_out, found, words in (
        (Path(photos[0].name), 2, "0 photos beside the views; name 1 to 6"),  # under another name
        (tmp_path / "none.jpg", 3, "none.jpg"),
    ):
        command = (*photos[:2], "--holdout", held_out, "-o", tmp_path / "r")
        code, _, err = measure(*command, "--sizes", 16)
        assert (code, words in err) == (found, True), err
        assert not (tmp_path / "r").exists()
