"""`styl3r tradeoff`: what is measured, how agreement is counted, and what a report has."""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from styl3r_cli.gaussians import Gaussians
from styl3r_cli.tradeoff import worker
from styl3r_cli.tradeoff.agreement import View, differences
from styl3r_cli.tradeoff.plots import pareto
from styl3r_cli.tradeoff.points import GIVEN, Dials, Point
from styl3r_cli.tradeoff.rows import CLASSES, Row, advise, corresponding

Run = Callable[..., tuple[int, bytes, str]]
REFERENCE = Point(GIVEN, 64, 3, 100.0, "exact", 1)
FEW = (
    *("--precisions", "w8", "--sizes", "64,48", "--views", "3,2", "--budgets", "100"),
    *("--drawings", "exact,draft", "--colours", "fitted", "--repeats", 2),
)


def scene(count: int = 50, seed: int = 0) -> Gaussians:
    random = np.random.default_rng(seed)
    turns = random.standard_normal((count, 4))
    return Gaussians(
        random.standard_normal((count, 3)).astype(np.float32),
        random.uniform(0.1, 1, (count, 3)).astype(np.float32),
        (turns / np.linalg.norm(turns, axis=1, keepdims=True)).astype(np.float32),
        random.random(count).astype(np.float32),
        random.random((count, 3)).astype(np.float32),
    )


def row(scene_seconds: float, megabytes: float, decibels: float, precision: str = GIVEN) -> Row:
    point = Point(precision, 64, 3, megabytes, "exact", 1)
    view = View(False, decibels, 1.0)
    return Row(point, {"scene": scene_seconds}, bytes=round(megabytes * 1e6), views=[view])


def test_differences_are_those_that_were_made() -> None:
    truth = scene()
    moved = Gaussians(
        truth.means * np.float32(1.01),
        truth.scales,
        -truth.rotations,  # the same rotations
        truth.opacities + np.float32(0.25),
        truth.colours,
    )
    found = differences(moved, truth)
    assert found["means"].relative == pytest.approx(0.01, rel=1e-3)
    assert found["means"].largest == pytest.approx(0.01 * np.abs(truth.means).max(), rel=1e-3)
    assert found["opacities"].largest == pytest.approx(0.25, rel=1e-6)
    assert found["rotations"].largest == found["scales"].largest == found["colours"].relative == 0
    assert differences(scene(49), truth) == {}


def test_gaussians_of_the_same_pixels_are_compared() -> None:
    """Which of two views' Gaussians stands for a surface may be decided by rounding."""
    whole = scene(12)

    def stored(pixels: list[int]) -> dict[str, np.ndarray]:
        chosen = np.zeros((2, 2, 3), np.bool_)
        chosen.flat[pixels] = True
        arrays = {k: getattr(whole, k)[chosen.ravel()] for k in Gaussians.__dataclass_fields__}
        return arrays | {"pixels": chosen}

    ours, theirs = corresponding(stored([0, 1, 4, 7]), stored([1, 4, 5, 11]))
    np.testing.assert_array_equal(ours.means, whole.means[[1, 4]])
    assert {each.largest for each in differences(ours, theirs).values()} == {0.0}
    fewer = stored([0, 1, 4, 7])
    fewer |= {k: fewer[k][:3] for k in Gaussians.__dataclass_fields__}  # compacted
    assert differences(*corresponding(fewer, stored([0, 1, 4]))) == {}
    other = stored([0]) | {"pixels": np.ones((1, 1, 1), np.bool_)}  # of smaller photos
    assert differences(*corresponding(other, stored([0]))) == {}


def test_each_dial_is_turned_alone_or_all_together() -> None:
    dials = Dials([GIVEN, "w8"], [64, 48], [3, 2], [100.0], ["exact"], [1], ["fitted"])
    points = dials.points(grid=False)
    assert points[0] == dials.reference == REFERENCE
    assert len(points) == len({point.key for point in points}) == 4
    for point in points[1:]:
        different = [k for k, v in point.to_dict().items() if v != REFERENCE.to_dict()[k]]
        assert len(different) == 1
    assert len(set(dials.points(grid=True))) == 8


def test_only_what_nothing_beats_is_on_the_front() -> None:
    assert pareto([(3, 50), (1, 30), (2, 20), (2, 40), (4, 50)]) == [1, 3, 0]


def test_what_breaks_the_scene_is_never_recommended() -> None:
    rows = [
        row(1.0, 10, 100),
        row(0.8, 8, 41),
        row(0.7, 2, 36),
        row(0.1, 1, 29.9, "int8"),
        Row(Point("w4", 64, 3, 1, "exact", 1), failed="no finite Gaussian"),
    ]
    advice = {(each.decibels, each.name): each.row for each in advise(rows)}
    assert set(CLASSES.values()) == {40.0, 35.0, 30.0}
    assert advice[40.0, "fastest scene"] is advice[40.0, "smallest scene"] is rows[1]
    assert advice[30.0, "fastest scene"] is rows[2]
    assert [each.rejected(rows[0].point) for each in rows] == [False, False, False, True, True]


def test_a_scene_in_another_unit_is_brought_to_ours() -> None:
    poses = [np.eye(4) for _ in range(3)]
    for index, pose in enumerate(poses):
        pose[:3, 3] = index
    larger = [pose.copy() for pose in poses]
    for pose in larger:
        pose[:3, 3] *= 2.5
    assert worker.relative_scale(larger, poses) == pytest.approx(2.5)


def test_a_report_is_whole_and_needs_nothing_else(
    measure: Run, here: list[dict[str, Any]], photos: list[Path], style: Path, tmp_path: Path
) -> None:
    pytest.importorskip("onnx_ir")
    pytest.importorskip("matplotlib")
    target = tmp_path / "report"
    code, out, err = measure(*photos, "-s", style, "-o", target, "--fov", 60, *FEW)
    assert code == 0, err
    report = json.loads((target / "tradeoff.json").read_text())
    points = {(p["precision"], p["size"], p["views"], p["drawing"]): p for p in report["points"]}
    assert set(points) == {
        (GIVEN, 64, 3, "exact"),
        ("w8", 64, 3, "exact"),
        (GIVEN, 48, 3, "exact"),
        (GIVEN, 64, 2, "exact"),
        (GIVEN, 64, 3, "draft"),
    }
    assert [len(here), *{p["repeats"] for p in points.values()}] == [10, 2]
    reference, smaller = points[GIVEN, 64, 3, "exact"], points[GIVEN, 48, 3, "exact"]
    assert reference["input_psnr_worst"] == reference["novel_psnr_worst"] == 100
    assert points["w8", 64, 3, "exact"]["input_psnr_worst"] == 100  # it has no large weight
    assert smaller["gaussians"] == 3 * 48 * 48 < reference["gaussians"] == 3 * 64 * 64
    assert 20 < smaller["input_psnr_worst"] < 60
    assert points[GIVEN, 64, 3, "draft"]["means_largest_error"] == 0
    assert reference["memory_bytes"] > 10e6
    with (target / "tradeoff.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [float(line["seconds_scene"]) for line in lines] == [
        p["seconds_scene"] for p in report["points"]
    ]
    page = (target / "index.html").read_text()
    assert page.count("<svg") == 5
    assert page.count("data:image/jpeg;base64,") == 5
    assert not re.findall(r'(?:src|href)="(?!data:|#)', page)
    assert len(out.decode().splitlines()) == 1 + 5 + len(report["recommended"])


@pytest.mark.parametrize(
    ("given", "told", "expected"),
    [
        (("--sizes", "100"), "multiples of 16", 2),
        (("--views", "4"), "there are 3 photos", 2),
        (("--style", "none.png"), "no such style picture", 3),
        (("--precisions", "int7"), "int7", 2),
        (("--fov", "nan"), "--fov nan", 2),
        (("-",), "error: -: a trade-off takes no list of photos", 2),
        (("--holdout", "-"), "error: -: a trade-off takes no list of photos", 2),
    ],
)
def test_what_cannot_be_measured_is_refused(
    measure: Run,
    photos: list[Path],
    tmp_path: Path,
    given: tuple[str, ...],
    told: str,
    expected: int,
) -> None:
    code, _, err = measure(*photos, "-o", tmp_path / "r", *given)
    assert (code, told in err) == (expected, True), err
    assert not (tmp_path / "r").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX pipes")
def test_what_comes_through_a_pipe_is_not_awaited(
    measure: Run, photos: list[Path], tmp_path: Path
) -> None:
    """Every measurement reads the cameras anew, which a pipe has only once."""
    os.mkfifo(tmp_path / "cameras.json")
    code, _, err = measure(*photos, "-o", tmp_path / "r", "--cameras", tmp_path / "cameras.json")
    assert (code, "cameras.json: a pipe; a trade-off reads files" in err) == (3, True)


@pytest.mark.slow
def test_points_are_measured_in_processes_of_their_own(
    measure: Run, photos: list[Path], tmp_path: Path
) -> None:
    code, _, err = measure(
        *(*photos, "-o", tmp_path / "r", "--precisions", "fp32", "--sizes", "64", "--views", "3"),
        *("--budgets", "100,50", "--drawings", "exact", "--repeats", 1),
        *("--colours", "fitted,plain"),
    )
    assert code == 0, err
    points = json.loads((tmp_path / "r" / "tradeoff.json").read_text())["points"]
    assert points[1]["gaussians"] <= points[0]["gaussians"] / 2
    assert points[1]["seconds_compact"] > 0


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere peaks are one's own")
def test_a_points_memory_is_its_own() -> None:
    """Not that of the process that started it, which Linux reports in getrusage."""
    ballast = np.ones(300 << 20, np.uint8)
    code = "from styl3r_cli.tradeoff.worker import peak_memory; print(peak_memory())"
    started = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert 10e6 < int(started.stdout) < ballast.nbytes
