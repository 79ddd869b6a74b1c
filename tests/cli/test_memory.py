"""Memory that ends, and libraries that do not load whole: one line that says so."""

from __future__ import annotations

import errno
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from styl3r_cli import main, memory
from styl3r_cli.errors import ExitCode, ModelError, OutOfMemoryError
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


def test_a_limit_that_is_too_low_is_said_before_the_model_loads(
    run: Run, photos: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "address_space", lambda: 500 << 20)
    code, out, err = run("reconstruct", *photos, "-o", tmp_path / "x.ply", "--fov", "50")
    assert (code, out, err.count("\n")) == (1, b"", 1)
    assert "out of memory: this process may use 500 MB of addresses, and needs 1200 MB" in err
    assert not (tmp_path / "x.ply").exists()
    monkeypatch.setattr(memory, "address_space", lambda: 130 << 20)
    assert (
        main.run(["info", str(tmp_path / "x.ply")]) == ExitCode.INTERNAL
    )  # before it is looked for
    monkeypatch.setattr(memory, "address_space", lambda: None)
    memory.check_limit(memory.LEAST_FOR_NETWORK)
