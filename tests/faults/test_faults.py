"""Disks that are full, processes that are killed, memory that ends: nothing lost, nothing half.

STYL3R_KILLS is how often a run is killed at a random moment (20 by default).
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from limited import KINDS, limited, one_line

from styl3r_cli import needs
from styl3r_cli.files import TEMP_PREFIX

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="limits, signals and mounts are Linux's"),
]
KILLS = int(os.environ.get("STYL3R_KILLS", "20"))
OLD = b"what was here before"
NAMES = ("scene.ply", "cameras.json")
Start = Callable[..., "subprocess.Popen[bytes]"]


@pytest.fixture
def start(tiny_model: Path, photos: list[Path]) -> Start:
    """Starts `reconstruct` into a folder (or `-o` something else), limited as asked for."""

    def begin(folder: Path, output: str = NAMES[0], **options: object) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "styl3r_cli", "reconstruct", *map(str, photos), "-q"]
        command += ["--model", str(tiny_model), "--fov", "50", "--threads", "1", "--all"]
        target = output if output == "-" else str(folder / output)
        command += ["-o", target, "--cameras-out", str(folder / NAMES[1])]
        settings = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
        return subprocess.Popen(command, **settings)  # type: ignore[call-overload,no-any-return]

    return begin


def ended(process: subprocess.Popen[bytes]) -> tuple[int, str]:
    """Exit code and standard error."""
    _, err = process.communicate(timeout=300)
    return process.returncode, (err or b"").decode()


def litter(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir() if path.name not in NAMES]


@pytest.fixture
def good(start: Start, tmp_path: Path) -> dict[str, bytes]:
    """What an undisturbed run writes."""
    folder = tmp_path / "good"
    folder.mkdir()
    assert ended(start(folder)) == (0, "")
    assert litter(folder) == []
    return {name: (folder / name).read_bytes() for name in NAMES}


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A folder with results of an earlier run."""
    folder = tmp_path / "out"
    folder.mkdir()
    for name in NAMES:
        (folder / name).write_bytes(OLD)
    return folder


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 256 kB, where this user may mount one."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(folder)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("mounting is for root")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk(start: Start, small_disk: Path) -> None:
    (small_disk / NAMES[0]).write_bytes(OLD)
    code, err = ended(start(small_disk))
    assert (code, one_line(err)) == (6, True)
    assert "No space left" in err
    assert (small_disk / NAMES[0]).read_bytes() == OLD
    assert litter(small_disk) == []


def test_a_read_only_disk(start: Start, small_disk: Path) -> None:
    subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], check=True)
    code, err = ended(start(small_disk))
    assert (code, one_line(err), list(small_disk.iterdir())) == (6, True, [])


def test_a_quota(start: Start, out: Path) -> None:
    import resource

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))

    code, err = ended(start(out, preexec_fn=limit))
    assert (code, one_line(err)) == (6, True)
    assert [(out / name).read_bytes() for name in NAMES] == [OLD, OLD]
    assert litter(out) == []


def test_a_full_device_behind_standard_output(start: Start, out: Path) -> None:
    with Path("/dev/full").open("wb") as full:
        code, err = ended(start(out, "-", stdout=full))
    assert (code, one_line(err)) == (6, True)
    assert "No space left" in err


def test_killed_at_any_moment(start: Start, out: Path, good: dict[str, bytes]) -> None:
    """Each file is the old or the new one, whole; the next run is as if nothing had been."""
    begin = time.monotonic()
    ended(start(out))
    took = time.monotonic() - begin
    chance = random.Random(0)
    for _ in range(KILLS):
        for name in NAMES:
            (out / name).write_bytes(OLD)
        process = start(out)
        time.sleep(chance.uniform(0, 1.1 * took))
        process.kill()
        process.communicate()
        for name in NAMES:
            assert (out / name).read_bytes() in (OLD, good[name])
        assert all(name.startswith(TEMP_PREFIX) for name in litter(out))
    assert ended(start(out)) == (0, "")
    assert {name: (out / name).read_bytes() for name in NAMES} == good


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_told_to_end_at_any_moment(
    start: Start, out: Path, good: dict[str, bytes], number: signal.Signals
) -> None:
    """As above, and no temporary file stays."""
    chance = random.Random(1)
    for _ in range(max(KILLS // 4, 1)):
        process = start(out)
        time.sleep(chance.uniform(0.5, 3))
        process.send_signal(number)
        process.communicate(timeout=300)
        assert litter(out) == []
        for name in NAMES:
            assert (out / name).read_bytes() in (OLD, good[name])


def test_two_write_the_same(start: Start, out: Path, good: dict[str, bytes]) -> None:
    both = [start(out), start(out)]
    assert [ended(process) for process in both] == [(0, ""), (0, "")]
    assert {name: (out / name).read_bytes() for name in NAMES} == good
    assert litter(out) == []


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("megabytes", [15, 100, 200, 400, 800, 1200, 1600, 2000, 2600, 4000])
def test_memory_that_ends(
    start: Start, out: Path, good: dict[str, bytes], megabytes: int, kind: str
) -> None:
    """However much there is: done, or one line and nothing written; never a crash."""
    code, err = ended(start(out, preexec_fn=limited(kind, megabytes << 20)))
    assert litter(out) == []
    for name in NAMES:
        assert (out / name).read_bytes() in (OLD, good[name])
    if code or megabytes << 20 < getattr(needs.scene(0), kind):
        assert (code, one_line(err), "out of memory" in err) == (1, True, True)
    else:
        assert err == ""


def test_no_place_for_caches(start: Start, out: Path, good: dict[str, bytes]) -> None:
    """No home, no folder for temporary files, and kernels that cannot be kept."""
    nowhere = {"HOME": "/nowhere", "TMPDIR": "/nowhere", "XDG_CACHE_HOME": "/nowhere"}
    environment = os.environ | nowhere | {"NUMBA_CACHE_DIR": "/proc/nowhere"}
    assert ended(start(out, env=environment)) == (0, "")
    assert (out / NAMES[0]).read_bytes() == good[NAMES[0]]
    command = [sys.executable, "-m", "styl3r_cli", "render", str(out / NAMES[0]), "-q"]
    command += ["-o", str(out.parent / "a.png"), "--frames", "1", "--size", "64"]
    drawn = subprocess.run(command, capture_output=True, env=environment, check=False, timeout=300)
    assert (drawn.returncode, drawn.stderr) == (0, b"")
