"""Memory that ends, and libraries that do not load whole: one line that says so."""

from __future__ import annotations

import errno
import re
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import click
import numpy as np
import pytest

from styl3r_cli import graphs, limits, main, memory, needs
from styl3r_cli.errors import ExitCode, ModelError, OutOfMemoryError
from styl3r_cli.formats import write_scene
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.onnx_library import NEEDED, onnxruntime

Run = Callable[..., tuple[int, bytes, str]]


def caused(error: Exception, cause: Exception) -> Exception:
    error.__cause__ = cause
    return error


ENDED = [
    MemoryError(),
    ImportError("libx.so: failed to map segment from shared object"),
    ImportError("libx.so: cannot create shared object descriptor: Cannot allocate memory"),
    OSError(errno.ENOMEM, "Cannot allocate memory"),
    RuntimeError("can't start new thread"),
    RuntimeError("std::bad_alloc"),
    ValueError("encoding error 1"),
    caused(ImportError("numpy: Error importing numpy"), MemoryError()),
]


@pytest.mark.parametrize("error", ENDED)
def test_memory_that_ends_is_no_bug(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(**_: object) -> None:
        raise error

    monkeypatch.setattr(main.group, "main", fail)
    assert main.run([]) == ExitCode.INTERNAL
    assert capsys.readouterr().err == f"styl3r: error: {main.OUT_OF_MEMORY}\n"


@pytest.mark.parametrize(
    ("command", "advice"),
    [
        ("reconstruct x.jpg -o x.ply", "; try a smaller --size, or fewer and smaller photos"),
        ("render x.ply -o x.mp4", "; try a smaller --size"),
        ("bench render", "; try smaller --sizes, or fewer --gaussians"),
        ("info x.ply", ""),
        ("convert x.ply x.spz", ""),
    ],
)
def test_advice_is_of_the_commands_own_options(
    command: str, advice: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(click.Command, "invoke", fail)
    assert main.run(command.split()) == ExitCode.INTERNAL
    assert capsys.readouterr().err == f"styl3r: error: out of memory{advice}\n"


@pytest.mark.parametrize(
    "error",
    [
        ImportError("libx.so: cannot allocate memory in static TLS block"),
        ImportError("No module named 'x'"),
        OSError(errno.ENOENT, "No such file or directory"),
    ],
)
def test_other_failures_are_not_called_memory(error: Exception) -> None:
    assert not memory.ended(error)


def test_failures_that_led_to_each_other() -> None:
    first, second = ValueError("a"), ValueError("b")
    first.__cause__, second.__cause__ = second, first
    assert not memory.ended(first)


def shadow(monkeypatch: pytest.MonkeyPatch, folder: Path, code: str) -> None:
    """Another onnxruntime, found first."""
    (folder / "onnxruntime.py").write_text(code)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setitem(sys.modules, "onnxruntime", ModuleType("placeholder"))
    monkeypatch.delitem(sys.modules, "onnxruntime")  # both are undone, and the real one is back


@pytest.mark.parametrize(
    ("code", "kind", "words"),
    [
        ("raise ImportError('libx.so: failed to map segment')", OutOfMemoryError, "out of memory"),
        ("raise OSError(12, 'Cannot allocate memory')", OutOfMemoryError, "out of memory"),
        ("raise ImportError('libx.so: not found')", ModelError, "damaged .libx.so: not found.; "),
        ("raise Exception", ModelError, "onnxruntime is damaged .Exception.; reinstall it"),
        ("InferenceSession = None", ModelError, "it has no RunOptions.; reinstall it"),
    ],
)
def test_an_onnxruntime_that_does_not_load(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, code: str, kind: type[Exception], words: str
) -> None:
    shadow(monkeypatch, tmp_path, code)
    for _ in range(2):  # what is left of the first attempt changes nothing
        with pytest.raises(kind, match=words):
            onnxruntime()


def test_threads_never_see_a_part_of_onnxruntime(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Python hands a module whose import failed to the threads that waited for it."""
    shadow(monkeypatch, tmp_path, "import time; time.sleep(0.2); raise ImportError('bad_alloc')")
    seen: list[ModuleType | Exception] = []

    def load() -> None:
        try:
            seen.append(onnxruntime())
        except Exception as error:
            seen.append(error)

    threads = [threading.Thread(target=load) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [type(one) for one in seen] == [OutOfMemoryError] * 3


def test_onnxruntime_is_whole() -> None:
    assert all(hasattr(onnxruntime(), name) for name in NEEDED)


@pytest.mark.parametrize(("kind", "what"), [("addresses", "addresses"), ("data", "data")])
def test_a_limit_that_is_too_low_is_said_before_the_model_loads(
    run: Run,
    photos: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    kind: str,
    what: str,
) -> None:
    monkeypatch.setattr(limits, kind, lambda: 500 << 20)
    monkeypatch.setattr(graphs.Model, "load", lambda *_: pytest.fail("the model was loaded"))
    code, out, err = run("reconstruct", *photos, "-o", tmp_path / "x.ply", "--fov", "50")
    assert (code, out, err.count("\n")) == (1, b"", 1)
    assert f"out of memory: this process may use 500 MB of {what}, and needs " in err
    assert not (tmp_path / "x.ply").exists()
    monkeypatch.setattr(limits, kind, lambda: 130 << 20)
    assert (
        main.run(["info", str(tmp_path / "x.ply")]) == ExitCode.INTERNAL
    )  # before it is looked for
    monkeypatch.setattr(limits, kind, lambda: None)
    limits.check(needs.network())


def small_scene(folder: Path) -> Path:
    one = np.ones((1, 3), np.float32)
    path = folder / "x.ply"
    write_scene(path, Gaussians(one, one, np.eye(4, dtype=np.float32)[:1], one[:, 0], one))
    return path


def test_frames_that_no_machine_has_memory_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A terabyte is refused by what this machine has; nothing limits the process."""
    scene, picture = small_scene(tmp_path), tmp_path / "x.png"
    words = ["render", str(scene), "-o", str(picture), "--frames", "1", "--size", "99999x99999"]
    assert main.run(words) == ExitCode.INTERNAL
    err = capsys.readouterr().err
    assert re.search(r"this machine or container has \d+ MB, and 95\d{4} MB or more are", err)
    assert err.count("\n") == 1
    assert not picture.exists()


@pytest.mark.parametrize(("there", "code"), [(24 << 20, 1), (25 << 20, 0)])
def test_a_container_may_have_less_than_the_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: int, code: int
) -> None:
    """A frame of 512x512 needs 25 MB that grow with it; what is reserved is not counted."""
    told = tmp_path / "memory.max"
    told.write_text(f"{there + 300}\n")
    monkeypatch.setattr(limits, "CONTAINERS", (str(told), str(tmp_path / "none")))
    assert limits.memory() == there + 300
    words = ["render", str(small_scene(tmp_path)), "-o", str(tmp_path / "x.png")]
    assert main.run([*words, "--frames", "1", "--size", "512x512", "-q"]) == code
    told.write_text("max\n")
    assert (limits.memory() or there) >= there


def test_more_photos_pixels_and_cores_need_more(monkeypatch: pytest.MonkeyPatch) -> None:
    few, many = needs.scene(2 * 256 * 256), needs.scene(8 * 256 * 256)
    assert few.addresses >= 2434 << 20  # as measured
    assert few.data >= 1477 << 20
    assert many.addresses >= 4897 << 20
    assert many.data >= 3344 << 20
    assert needs.network(2 * 256 * 256).addresses < few.addresses
    monkeypatch.setattr(needs, "available_cores", lambda: 16)
    assert needs.scene(2 * 256 * 256).addresses >= 4893 << 20


def test_the_sizes_of_info_are_not_begun_without_room_for_the_dearest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    one = np.ones((1, 3), np.float32)
    path = tmp_path / "x.ply"
    write_scene(path, Gaussians(one, one, np.eye(4, dtype=np.float32)[:1], one[:, 0], one))
    monkeypatch.setattr(limits, "addresses", lambda: 300 << 20)
    monkeypatch.setitem(sys.modules, "trimesh", None)
    assert main.run(["info", str(path)]) == ExitCode.INTERNAL
    assert capsys.readouterr().err.count("out of memory") == 1
    assert main.run(["info", "--no-sizes", str(path)]) == ExitCode.SUCCESS


@pytest.mark.skipif(sys.platform != "linux", reason="the limits are Linux's")
@pytest.mark.parametrize("megabytes", [7, 15, 60])
def test_hardly_any_data(megabytes: int) -> None:
    """Less than the libraries that tell of errors take, or numpy: it is told nevertheless."""
    import resource

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_DATA, (megabytes << 20, megabytes << 20))

    done = subprocess.run(
        [sys.executable, "-m", "styl3r_cli", "info", "x.ply"],
        preexec_fn=limited,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert done.stderr.startswith(f"styl3r: error: out of memory: this process may use {megabytes}")


# The limit is not root's: as somebody else, once all is loaded that only root may read.
AS_SOMEBODY = """
import os, resource, sys, threading
from styl3r_cli import main
if os.geteuid() == 0:
    os.setuid(65534)
resource.setrlimit(resource.RLIMIT_NPROC, (int(sys.argv[1]),) * 2)
main.main(["info", "x.ply"])
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the limits are Linux's")
@pytest.mark.parametrize("threads", [1, 5])
def test_hardly_any_threads(threads: int) -> None:
    """OpenBLAS interrupts a process that gets none, which would end as if by Ctrl-C."""
    command = [sys.executable, "-c", AS_SOMEBODY, str(threads)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert done.stderr.startswith("styl3r: error: out of threads: ")
    assert "(ulimit -u)" in done.stderr
