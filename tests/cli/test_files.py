"""Atomic writing and binary pipes: what is left on disk after success, failure and Ctrl-C."""

from __future__ import annotations

import errno
import io
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from styl3r_cli.errors import OutputError
from styl3r_cli.files import atomic_write, read_file


def listing(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def test_success_replaces_the_file_and_leaves_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "scene.ply"
    target.write_bytes(b"old")
    with atomic_write(target) as temporary:
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".ply"
        temporary.write_bytes(b"new")
        assert target.read_bytes() == b"old"  # nothing is visible before the block ends
    assert target.read_bytes() == b"new"
    assert listing(tmp_path) == ["scene.ply"]


@pytest.mark.parametrize("error", [ValueError("x"), KeyboardInterrupt(), SystemExit(3)])
def test_any_failure_keeps_the_old_file(tmp_path: Path, error: BaseException) -> None:
    target = tmp_path / "scene.ply"
    target.write_bytes(b"old")

    def interrupted() -> None:
        with atomic_write(target) as temporary:
            temporary.write_bytes(b"half")
            raise error

    with pytest.raises(type(error)):
        interrupted()
    assert target.read_bytes() == b"old"
    assert listing(tmp_path) == ["scene.ply"]


def test_ctrl_c_as_soon_as_the_temporary_file_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    really_open = os.open

    def interrupted(*arguments: object) -> int:
        os.close(really_open(*arguments))  # type: ignore[arg-type]
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "open", interrupted)
    with pytest.raises(KeyboardInterrupt), atomic_write(tmp_path / "a.ply"):
        pass
    monkeypatch.undo()
    assert listing(tmp_path) == []


def test_full_disk_becomes_one_clear_line(tmp_path: Path) -> None:
    def full() -> None:
        with atomic_write(tmp_path / "a.ply"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(OutputError, match=r"cannot write .*a\.ply: No space left on device"):
        full()
    assert listing(tmp_path) == []


def test_missing_folder_and_folder_as_target_say_so(tmp_path: Path) -> None:
    for target, words in [(tmp_path / "no" / "a.ply", "does not exist"), (tmp_path, "is a folder")]:
        with pytest.raises(OutputError, match=words), atomic_write(target):
            raise AssertionError("the block must not run")


def test_permissions_follow_the_umask_then_the_existing_file(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    previous = os.umask(0o027)
    try:
        with atomic_write(target) as temporary:
            temporary.write_text("1")
    finally:
        os.umask(previous)
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    target.chmod(0o604)
    with atomic_write(target) as temporary:
        temporary.write_text("2")
    assert stat.S_IMODE(target.stat().st_mode) == 0o604


def test_symbolic_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    target, link = tmp_path / "real" / "a.txt", tmp_path / "link.txt"
    target.write_text("old")
    link.symlink_to(target)
    with atomic_write(link) as temporary:
        temporary.write_text("new")
    assert link.is_symlink()
    assert target.read_text() == "new"


def test_what_another_name_of_the_file_leads_to_stays(tmp_path: Path) -> None:
    """A result whose name is a hard link of an input replaces the name, and not the input."""
    entered, result = tmp_path / "a.txt", tmp_path / "result.txt"
    entered.write_text("input")
    result.hardlink_to(entered)
    with atomic_write(result) as temporary:
        temporary.write_text("new")
    assert (entered.read_text(), result.read_text()) == ("input", "new")


def test_devices_are_written_directly() -> None:
    with atomic_write(Path("/dev/null")) as temporary:
        assert temporary == Path("/dev/null")
    assert stat.S_ISCHR(Path("/dev/null").stat().st_mode)


def run(code: str, **kwargs: object) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-c", f"from styl3r_cli.files import *\n{code}"]
    return subprocess.run(command, capture_output=True, check=False, timeout=60, **kwargs)  # type: ignore[call-overload]


def test_stdin_to_stdout_is_binary_clean() -> None:
    data = bytes(range(256)) * 5
    assert run("write_stdout(read_stdin())", input=data).stdout == data


def test_empty_stdin_is_an_input_error() -> None:
    result = run("read_stdin()", input=b"")
    assert b"InputError: -: standard input is empty" in result.stderr


def test_terminal_is_refused() -> None:
    reader, terminal = os.openpty()
    try:
        command = [sys.executable, "-c", "from styl3r_cli.files import *; write_stdout(b'ply')"]
        result = subprocess.run(
            command, stdout=terminal, stderr=subprocess.PIPE, check=False, timeout=60
        )
    finally:
        os.close(terminal)
        os.close(reader)
    assert b"UsageError" in result.stderr
    assert b"is a terminal" in result.stderr


def test_closed_pipe_is_one_error_without_noise_at_exit() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    code = "try: write_stdout(b'x' * 10**6)\nexcept OutputError as e: raise SystemExit(str(e))"
    command = [sys.executable, "-c", f"from styl3r_cli.files import *\n{code}"]
    result = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, check=False, timeout=60)
    os.close(writer)
    assert result.stderr.decode().strip().endswith("closed it early")
    assert result.stderr.count(b"\n") == 1


def test_reader_that_leaves_early_is_noticed_without_buffering() -> None:
    """A raw stream (python -u) does not fail: it takes a part, says so, and fails the next time."""
    code = "try: write_stdout(b'x' * 10**6)\nexcept OutputError as e: raise SystemExit(str(e))"
    command = [sys.executable, "-u", "-c", f"from styl3r_cli.files import *\n{code}"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, bufsize=0) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.read(100) == b"x" * 100
        process.stdout.close()
        assert process.stderr.read().decode().strip().endswith("closed it early")


def test_what_has_nothing_to_say_yet_is_no_bug(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As /proc/kmsg, whose reading would take the messages from others."""
    (tmp_path / "silent").touch()

    class Silent(io.FileIO):
        def readall(self) -> None:  # type: ignore[override]
            return None

    monkeypatch.setattr("builtins.open", lambda name, *_, **__: io.BufferedReader(Silent(name)))
    with pytest.raises(OSError, match="nothing to be read"):
        read_file(tmp_path / "silent")
