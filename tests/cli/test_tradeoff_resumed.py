"""`styl3r tradeoff` goes on where a run was interrupted, killed or out of room."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from styl3r_cli.tradeoff import bench
from styl3r_cli.tradeoff.journal import alone_in

ORIGINAL_WORK = bench.work
Run = Callable[..., tuple[int, bytes, str]]


def plain_run(tmp_path: Path, *more: object) -> tuple[object, ...]:
    """A reference and a smaller size, once each."""
    plain = ("-o", tmp_path / "r", "--precisions", "fp32", "--sizes", "48,32", "--views", "2")
    plain = (*plain, "--budgets", "100", "--drawings", "exact", "--colours", "plain")
    return (*plain, "--fov", 60, "--repeats", 1, *more)


def changed(line: bytes) -> bytes:
    return line.replace(b'"gaussians": ', b'"gaussians": 1')


@pytest.mark.parametrize(
    ("damage", "lost"),
    [
        (lambda lines: [*lines, b'{"point": 3}\n'], 0),
        (lambda lines: [*lines, b"[]\n"], 0),
        (lambda lines: [*lines, b"\xff\xfe\0"], 0),
        (lambda lines: [*lines[:-1], lines[-1][:-40]], 1),
        (lambda lines: [*lines[:-1], changed(lines[-1])], 1),
        (lambda lines: [lines[0], changed(lines[1]), lines[2]], 2),
        (lambda lines: [b"\n", *lines], 2),
    ],
)
def test_lines_that_are_not_as_written_are_measured_anew_once(
    measure: Run,
    here: list[dict[str, Any]],
    photos: list[Path],
    tmp_path: Path,
    damage: Callable[[list[bytes]], list[bytes]],
    lost: int,
) -> None:
    assert measure(*photos, *plain_run(tmp_path))[0] == 0
    journal, whole = tmp_path / "r" / "work" / bench.JOURNAL, len(here)
    assert whole == 2
    journal.write_bytes(b"".join(damage(journal.read_bytes().splitlines(keepends=True))))
    for _ in range(2):
        code, _, err = measure(*photos, *plain_run(tmp_path))
        assert code == 0, err
        assert len(here) == whole + lost


@pytest.mark.parametrize("data", [b"x", b"PK\x03\x04", None])
def test_pictures_that_are_not_as_written_are_made_anew(
    measure: Run,
    here: list[dict[str, Any]],
    photos: list[Path],
    tmp_path: Path,
    data: bytes | None,
) -> None:
    assert measure(*photos, *plain_run(tmp_path))[0] == 0
    first, _ = sorted((tmp_path / "r" / "work").glob("*.npz"))
    first.unlink()
    if data is not None:
        first.write_bytes(data)
    else:
        np.savez(first, means=np.zeros((1, 3)))
    code, _, err = measure(*photos, *plain_run(tmp_path))
    assert (code, len(here)) == (0, 3), err


def test_a_photo_that_changed_is_another(
    measure: Run, here: list[dict[str, Any]], photos: list[Path], tmp_path: Path
) -> None:
    """Also one of as many bytes."""
    copies = [tmp_path / f"{index}.bmp" for index in range(2)]
    for copy, photo in zip(copies, photos, strict=False):
        Image.open(photo).convert("RGB").save(copy)
    assert measure(*copies, *plain_run(tmp_path))[0] == 0
    Image.open(copies[1]).transpose(Image.Transpose.FLIP_LEFT_RIGHT).save(copies[1])
    assert measure(*copies, *plain_run(tmp_path))[0] == 0
    assert len(here) == 4


def test_what_the_disk_would_not_take_is_tried_again(
    measure: Run, photos: list[Path], tmp_path: Path
) -> None:
    """A folder in the place of a point's pictures stands for a full disk."""
    work = tmp_path / "r" / "work"
    blocker = work / "given_48_2views_100pc_exact_1_plain.npz"
    blocker.mkdir(parents=True)
    code, _, err = measure(*photos, *plain_run(tmp_path, "--threads", 1))
    assert (code, f"cannot write {blocker}" in err) == (6, True), err
    blocker.rmdir()
    assert measure(*photos, *plain_run(tmp_path, "--threads", 1))[0] == 0


def test_a_worker_that_was_killed_is_tried_again(
    measure: Run,
    photos: list[Path],
    tmp_path: Path,
    here: list[dict[str, Any]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    measured = bench.work
    killed = [sys.executable, "-c", "import os; os.kill(os.getpid(), 9)"]

    def second_is_killed(job: dict[str, Any]) -> dict[str, Any]:
        if job["point"]["size"] == 48:
            return measured(job)
        with monkeypatch.context() as patch:
            run = subprocess.run
            patch.setattr(subprocess, "run", lambda _, **options: run(killed, **options))
            return ORIGINAL_WORK(job)

    monkeypatch.setattr(bench, "work", second_is_killed)
    assert measure(*photos, *plain_run(tmp_path))[0] == 0
    points = json.loads((tmp_path / "r" / "tradeoff.json").read_text())["points"]
    assert [bool(point["failed"]) for point in points] == [False, True]
    monkeypatch.setattr(bench, "work", measured)
    assert measure(*photos, *plain_run(tmp_path))[0] == 0
    points = json.loads((tmp_path / "r" / "tradeoff.json").read_text())["points"]
    assert [bool(point["failed"]) for point in points] == [False, False]
    assert len(here) == 2


@pytest.mark.skipif(sys.platform == "win32", reason="no such locks there")
def test_one_run_at_a_time_in_a_folder(
    measure: Run, here: list[dict[str, Any]], photos: list[Path], tmp_path: Path
) -> None:
    work = tmp_path / "r" / "work"
    work.mkdir(parents=True)
    with alone_in(work):
        code, _, err = measure(*photos, *plain_run(tmp_path))
        assert (code, "another styl3r tradeoff is at work in it" in err) == (6, True)
    assert (list(work.iterdir()), len(here)) == ([], 0)
    assert measure(*photos, *plain_run(tmp_path))[0] == 0


@pytest.mark.parametrize("name", ["manifest.json", "structure.onnx"])
def test_a_precision_that_was_made_and_then_damaged_is_made_anew(
    measure: Run, here: list[dict[str, Any]], photos: list[Path], tmp_path: Path, name: str
) -> None:
    pytest.importorskip("onnx_ir")
    plain = ("-o", tmp_path / "r", "--precisions", "w8", "--sizes", "48", "--views", "2")
    plain = (*plain, "--budgets", "100", "--drawings", "exact", "--fov", 60, "--colours", "plain")
    assert measure(*photos, *plain, "--repeats", 1)[0] == 0
    made = tmp_path / "r" / "work" / "w8" / name
    whole = made.read_bytes()
    made.write_bytes(whole[:5])
    assert measure(*photos, *plain, "--repeats", 1)[0] == 0
    assert made.read_bytes() == whole


def test_interrupted_runs_go_on_and_other_inputs_start_anew(
    measure: Run,
    here: list[dict[str, Any]],
    photos: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plain = ("-o", tmp_path / "r", "--precisions", "fp32", "--sizes", "64,48", "--views", "3")
    plain = (*plain, "--budgets", "100", "--drawings", "exact", "--fov", 60)
    plain = (*plain, "--colours", "fitted")
    measured, whole = bench.work, 4

    def interrupt(job: dict[str, Any]) -> dict[str, Any]:
        if len(here) == whole - 1:
            raise KeyboardInterrupt
        return measured(job)

    monkeypatch.setattr(bench, "work", interrupt)
    code, out, err = measure(*photos, *plain, "--repeats", 2)
    assert code == 130
    assert "interrupted; the same command goes on" in err
    assert len(out.decode().splitlines()) >= 3
    report = json.loads((tmp_path / "r" / "tradeoff.json").read_text())
    assert [point["repeats"] for point in report["points"]] == [2, 1]

    journal = tmp_path / "r" / "work" / bench.JOURNAL
    journal.write_text(journal.read_text() + '{"point": "cut sh')  # as a power cut leaves it
    monkeypatch.setattr(bench, "work", measured)
    assert measure(*photos, *plain, "--repeats", 2)[0] == 0
    assert len(here) == whole
    report = json.loads((tmp_path / "r" / "tradeoff.json").read_text())
    assert [point["repeats"] for point in report["points"]] == [2, 2]

    assert measure(*photos[::-1], *plain, "--repeats", 1)[0] == 0
    assert len(here) == whole + 2


ASLEEP = """
import sys, time
from styl3r_cli.tradeoff import worker

def measure(job):
    print("at work", file=sys.stderr, flush=True)
    time.sleep(600)

worker.measure = measure
worker.main()
"""
ASKING = """
import subprocess, sys
subprocess.run([sys.executable, "-c", sys.argv[1]], input="{}", text=True)
"""


@pytest.mark.skipif(os.name != "posix", reason="processes have no new parent elsewhere")
def test_a_worker_does_not_outlive_who_asked() -> None:
    command = [sys.executable, "-c", ASKING, ASLEEP]
    asking = subprocess.Popen(command, stderr=subprocess.PIPE, start_new_session=True)
    assert asking.stderr is not None
    assert asking.stderr.readline() == b"at work\n"
    asking.kill()
    try:
        asking.communicate(timeout=20)  # the worker holds the pipe's other end
    finally:
        with suppress(ProcessLookupError):
            os.killpg(asking.pid, signal.SIGKILL)
