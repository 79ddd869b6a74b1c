"""Compiled kernels: kept on disk, never stale, and spread over threads."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading
from pathlib import Path

import numba
import numpy as np
import pytest

from styl3r_cli.splatting.compiler import kernel, parallel_for


def test_a_kernel_works_without_a_place_for_its_cache():
    names: dict = {}
    exec("def double(x):\n    return 2 * x", names)  # has no file, so numba finds no cache for it
    assert kernel(names["double"])(21) == 42


@pytest.mark.parametrize("variable", ["NUMBA_NUM_THREADS=0", "NUMBA_DISABLE_JIT=1"])
def test_settings_under_which_nothing_is_compiled_are_named(variable: str) -> None:
    name, value = variable.split("=")
    command = [sys.executable, "-m", "styl3r_cli", "bench", "render", "--gaussians", "9"]
    environment = os.environ | {name: value}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert done.stderr.startswith(f"styl3r: error: {name}")
    assert "unset it" in done.stderr


@pytest.mark.parametrize("collecting", [True, False])
def test_compiling_leaves_garbage_collection_as_it_was(collecting):
    during = []

    class Seen(numba.core.event.Listener):
        def on_start(self, event):
            during.append(gc.isenabled())

        def on_end(self, event):
            pass

    before = gc.isenabled()
    (gc.enable if collecting else gc.disable)()
    try:
        with numba.core.event.install_listener("numba:compile", Seen()):
            assert kernel(lambda x: x + 1)(1) == 2
            with pytest.raises(numba.TypingError):
                kernel(lambda x: x.no_such_attribute)(1)
        assert gc.isenabled() == collecting
    finally:
        (gc.enable if before else gc.disable)()
    assert during
    assert not any(during)


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


@pytest.mark.parametrize("fault", ["killed", "full disk", "Ctrl-C"])
def test_code_that_could_not_be_kept_is_not_mistaken_for_what_was(tmp_path: Path, fault: str):
    """A run ends at each file that it keeps, just after its sources have changed."""
    (tmp_path / "kernels.py").write_text(
        "import os, sys\nimport factors\nfrom styl3r_cli.splatting.compiler import kernel\n"
        "F = factors.F\n@kernel\ndef times(x):\n    return F * x\n"
        "def fail(*names):\n"
        "    global left\n    left -= 1\n"
        "    if left >= 0:\n        return replace(*names)\n"
        "    if fault == 'killed':\n        os._exit(9)\n"
        "    raise OSError(28, 'full') if fault == 'full disk' else KeyboardInterrupt\n"
        "left, fault, replace = int(sys.argv[1]), sys.argv[2], os.replace\n"
        "if left >= 0:\n    os.replace = fail\n"
        "print(times(10))\n"
    )

    def run(factor: int, kept: int = -1) -> str:
        (tmp_path / "factors.py").write_text(f"F = {factor}\n")
        command = [sys.executable, "-B", "-c", "import kernels", str(kept), fault]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        return done.stdout.strip()

    for kept in range(3):
        assert run(2) == "20"
        run(3, kept)
        if fault != "killed":
            assert not list(tmp_path.glob("__pycache__/*[!c]"))
        assert run(3) == "30"


def test_kinds_of_numbers_kept_at_once(tmp_path: Path):
    """Three first runs, each of another kind, see a cache in which nothing is yet."""
    (tmp_path / "kernels.py").write_text(
        "import os, pathlib, sys, time\nfrom styl3r_cli.splatting.compiler import kernel\n"
        "@kernel\ndef half(x):\n    return x / 2\n"
        "x = {'int': 3, 'float': 3.0, 'complex': 3j}[sys.argv[1]]\n"
        "def wait(*names, go=os.replace):\n"
        "    pathlib.Path(sys.argv[1]).touch()\n"
        "    while len(list(pathlib.Path().glob('*[tx]'))) < 3:\n        time.sleep(0.001)\n"
        "    go(*names)\n"
        "if len(sys.argv) > 2:\n    os.replace = wait\n"
        "print(half(x), sum(half.stats.cache_hits.values()))\n"
    )

    def start(kind: str, *more: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-B", "-c", "import kernels", kind, *more]
        return subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True)

    right = {"int": "1.5", "float": "1.5", "complex": "1.5j"}
    first = {kind: start(kind, "wait") for kind in right}
    for kind, process in first.items():
        assert process.communicate(timeout=100)[0].split() == [right[kind], "0"]
    for kind in right:
        assert start(kind).communicate(timeout=100)[0].split() == [right[kind], "1"]


@pytest.mark.parametrize("damage", ["none", "cut", "garbage", "bit", "read-only"])
def test_a_bad_cache_is_no_obstacle(tmp_path: Path, damage: str):
    """A child draws with a cache that was damaged, or cannot be written, since the last run."""
    (tmp_path / "kernels.py").write_text(
        "import sys\nfrom styl3r_cli.splatting.compiler import kernel\n"
        "@kernel\ndef double(x):\n    return 2 * x\n"
        "if 'read-only' in sys.argv:\n"
        "    def refuse(*a):\n        raise PermissionError(13, 'read-only')\n"
        "    double._cache._cache_file.save = double._cache._cache_file.load = refuse\n"
        "print(double(21), sum(double.stats.cache_hits.values()))\n"
    )
    printed = []
    for _ in range(2):
        command = [sys.executable, "-B", "-c", "import kernels", damage]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
        printed.append(done.stdout.split())
        for file in tmp_path.glob("__pycache__/*.nb?"):
            data = file.read_bytes()
            middle = len(data) // 2
            if damage == "cut":
                file.write_bytes(data[:middle])
            elif damage == "garbage":
                file.write_bytes(b"?" * len(data))
            elif damage == "bit":  # of the machine code, whose first section follows ELF's head
                place = data.index(b"\x7fELF") + 64 if b"\x7fELF" in data else middle
                file.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
    assert [numbers[0] for numbers in printed] == ["42", "42"]
    assert (printed[1][1] == "1") == (damage == "none")


@pytest.mark.parametrize("threads", [1, 3, None])
@pytest.mark.parametrize("count", [0, 1, 5, 1000])
def test_every_index_is_visited_once(count, threads):
    visits = np.zeros(count, int)

    def visit(begin: int, end: int, array: np.ndarray) -> None:
        array[begin:end] += 1

    parallel_for(visit, count, threads, visits)
    costs = np.random.default_rng(count).integers(0, 9, count + 1).cumsum()
    parallel_for(visit, count, threads, visits, costs=costs)
    parallel_for(visit, count, threads, visits, costs=np.zeros(count + 1, int))
    assert (visits == 3).all()


def test_ctrl_c_while_a_thread_starts_ends_the_process():
    """The pool does not know of that thread yet, which Python would wait for at its exit."""
    code = (
        "import threading\nfrom styl3r_cli.splatting.compiler import parallel_for\n"
        "def start(thread, begin=threading.Thread.start):\n"
        "    begin(thread)\n    raise KeyboardInterrupt\n"
        "threading.Thread.start = start\n"
        "parallel_for(lambda begin, end: None, 9, 2)\n"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, timeout=200, check=False)
    assert b"KeyboardInterrupt" in done.stderr


def test_parts_cost_about_the_same():
    sizes = []
    costs = np.concatenate([[0], np.cumsum([1000, *[1] * 999])])
    parallel_for(lambda begin, end: sizes.append(costs[end] - costs[begin]), 1000, 2, costs=costs)
    assert max(sizes) <= 1000 + 1999 / 8


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
