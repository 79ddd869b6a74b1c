"""Compiled kernels: kept on disk, never stale, and spread over threads."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from styl3r_cli.splatting.compiler import kernel, parallel_for


def test_a_kernel_works_without_a_place_for_its_cache():
    names: dict = {}
    exec("def double(x):\n    return 2 * x", names)  # has no file, so numba finds no cache for it
    assert kernel(names["double"])(21) == 42


def test_kept_code_follows_the_modules_beside_it(tmp_path: Path):
    (tmp_path / "kernels.py").write_text(
        "import factors\nfrom styl3r_cli.splatting.compiler import kernel\n"
        "F = factors.F\n@kernel\ndef times(x):\n    return F * x\n"
        "print(times(10), sum(times.stats.cache_hits.values()))\n"
    )
    printed = []
    for factor in (2, 2, 3):
        (tmp_path / "factors.py").write_text(f"F = {factor}\n")
        command = [sys.executable, "-B", "-c", "import kernels"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
        printed.append(done.stdout.split())
    assert printed == [["20", "0"], ["20", "1"], ["30", "0"]]


@pytest.mark.parametrize("threads", [1, 3, None])
@pytest.mark.parametrize("count", [0, 1, 5, 1000])
def test_every_index_is_visited_once(count, threads):
    visits = np.zeros(count, int)

    def visit(begin: int, end: int, array: np.ndarray) -> None:
        array[begin:end] += 1

    parallel_for(visit, count, threads, visits)
    parallel_for(visit, count, threads, visits, min_parts=7)
    assert (visits == 2).all()


def test_work_is_spread_over_threads():
    meeting = threading.Barrier(2, timeout=30)

    def meet(begin: int, end: int) -> None:
        if begin in (0, 1):
            meeting.wait()  # returns only if the two parts run at the same time

    parallel_for(meet, 2, 2)


def test_an_error_in_a_thread_arrives():
    def fail(begin: int, end: int) -> None:
        raise ValueError("in a thread")

    with pytest.raises(ValueError, match="in a thread"):
        parallel_for(fail, 10, 2)
