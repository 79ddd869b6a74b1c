"""The command line as a program: start-up, help, exit codes, one line per failure."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from styl3r_cli import __version__, console, main
from styl3r_cli.errors import ExitCode, InputError, ModelError, OutputError, UsageError

HEAVY = ("numpy", "cv2", "onnxruntime", "numba", "av", "PIL", "torch")

SIGHUP = getattr(signal, "SIGHUP", 1)  # Windows has none


def python(code: str) -> str:
    """What a program prints."""
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def styl3r(*arguments: object, **options: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "styl3r_cli", *map(str, arguments)]
    return subprocess.run(  # type: ignore[call-overload]
        command, capture_output=True, text=True, check=False, timeout=120, **options
    )


def test_help_is_light_and_lists_everything() -> None:
    code = (
        "import sys; from styl3r_cli.main import run; code = run(['--help']);"
        f"print([m for m in {HEAVY} if m in sys.modules], code)"
    )
    text = python(code)
    assert text.endswith("[] 0")
    for word in ("stylize", "reconstruct", "render", "export", "Exit codes:", "130"):
        assert word in text


def test_importing_the_package_imports_nothing_heavy() -> None:
    code = f"import sys, styl3r_cli; print([m for m in {HEAVY} if m in sys.modules])"
    assert python(code) == "[]"


def test_help_answers_at_once() -> None:
    def seconds() -> float:
        """Processor time, which other programs on the machine do not change much."""
        before = os.times()
        assert styl3r("--help").returncode == 0
        after = os.times()
        user = after.children_user - before.children_user
        return user + after.children_system - before.children_system

    assert min(seconds() for _ in range(3)) < 0.3


@pytest.mark.parametrize("name", ["stylize", "reconstruct", "render"])
def test_help_of_commands_is_light(name: str) -> None:
    code = (
        f"import sys; from styl3r_cli.main import run; code = run(['{name}', '--help']);"
        f"print([m for m in {HEAVY} if m in sys.modules], code)"
    )
    text = python(code)
    assert text.endswith("[] 0")
    assert "--quiet" in text


def test_version() -> None:
    result = styl3r("--version")
    assert (result.returncode, result.stdout) == (0, f"styl3r {__version__}\n")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--nonsense"], "No such option"),
        (["nonsense"], "no command 'nonsense'; there are stylize"),
        (["stylize"], "Missing"),
        (["stylize", "a", "--nonsense"], "No such option"),
        (["stylize", "a", "--style", "b"], "Missing option '--output'"),
        (["stylize", "a", "-o", "x.ply", "--style", "b", "--strength", "2"], "range"),
        (["stylize", "a", "-o", "x.ply", "--style", "b", "--size", "0x4"], "not a size"),
        (["render", "x.ply", "-o", "y.mp4", "--speed", "fast"], "constant"),
        (["render", "x.ply", "-o", "y.mp4", "--fps"], "argument (see styl3r render --help)"),
        (["completion"], "choose from: bash, zsh, fish (see styl3r completion --help)"),
        (["render", "x.ply", "-o", "y.mp4", "--fps", "0"], "range"),
    ],
)
def test_wrong_command_lines_are_one_line(arguments: list[str], words: str) -> None:
    result = styl3r(*arguments)
    assert result.stdout == ""
    assert result.stderr.startswith("styl3r: error: ")
    assert result.stderr.count("\n") == 1
    assert words.lower() in result.stderr.lower()
    assert result.returncode == 2


def test_without_a_command_help_is_shown() -> None:
    result = styl3r()
    assert result.returncode == 2
    assert result.stdout == ""
    assert "Commands:" in result.stderr


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> Callable[[BaseException], int]:
    """Runs a command line that fails with an exception of one's choice."""

    def run(error: BaseException) -> int:
        def fail(**_options: object) -> None:
            raise error

        monkeypatch.setattr(main.group, "main", fail)
        return main.run([])

    return run


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (UsageError("what\nwhere"), 2),
        (InputError("what\nwhere"), 3),
        (ModelError("what\nwhere"), 4),
        (OutputError("what\nwhere"), 6),
    ],
)
def test_known_failures(
    failing: Callable[[BaseException], int],
    capsys: pytest.CaptureFixture[str],
    error: Exception,
    code: int,
) -> None:
    assert failing(error) == code
    assert capsys.readouterr() == ("", "styl3r: error: what\\nwhere\n")


def test_bugs_are_called_bugs(
    failing: Callable[[BaseException], int],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert failing(ZeroDivisionError("division by zero")) == ExitCode.INTERNAL
    text = capsys.readouterr().err
    assert text.startswith("styl3r: error: a bug: ZeroDivisionError: division by zero")
    assert text.count("\n") == 1
    monkeypatch.setenv(main.DEBUG, "1")
    with pytest.raises(ZeroDivisionError):
        failing(ZeroDivisionError())


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("SOURCE_DATE_EPOCH", "abc"),
        ("SOURCE_DATE_EPOCH", ""),
        ("OPENCV_FOR_THREADS_NUM", "abc"),
        ("OPENCV_IO_MAX_IMAGE_PIXELS", "x"),
        ("OPENCV_BUFFER_AREA_ALWAYS_SAFE", "zz"),
    ],
)
def test_what_libraries_could_not_read_in_the_environment_ends_nothing(
    name: str, value: str
) -> None:
    """In a process of its own: OpenCV and numpy read such variables when they are loaded."""
    program = (
        "from styl3r_cli import main; code = main.run(['info', 'gone.ply']);"
        "import cv2, numba; cv2.blur(__import__('numpy').ones((4, 4)), (3, 3)); exit(code)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {name: value},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == ExitCode.INPUT
    assert done.stderr.startswith("styl3r: error: gone.ply")
    assert done.stderr.count("\n") == 1


def test_interruptions_are_quiet(
    failing: Callable[[BaseException], int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert failing(KeyboardInterrupt()) == 130
    error = OutputError("closed early")
    error.__cause__ = BrokenPipeError()
    assert failing(error) == 141
    assert capsys.readouterr() == ("", "")


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (SIGHUP, 129)]
)
def test_signals_end_a_run_quietly(tmp_path: Path, number: int, code: int) -> None:
    fifo = tmp_path / "scene.ply"
    os.mkfifo(fifo)
    command = [sys.executable, "-m", "styl3r_cli", "render", str(fifo), "-o", "x.mp4"]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=tmp_path,
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),  # nohup would ignore SIGHUP
    )
    with fifo.open("wb"):  # opens when the program has opened it for reading
        time.sleep(0.1)
        process.send_signal(number)
        out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (code, b"", b"")
    assert [path.name for path in tmp_path.iterdir()] == ["scene.ply"]


UNWINDING = """
import os, signal, sys, time
from pathlib import Path
from styl3r_cli import endings, files
endings.unwind_on_signals()
"""


def ended(code: str, folder: Path, *arguments: str) -> tuple[int, bytes]:
    """Exit code and output of a program, which ends by itself within half a minute."""
    command = [sys.executable, *(arguments or ["-c", code])]
    done = subprocess.run(command, cwd=folder, capture_output=True, timeout=30, check=False)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_a_second_signal_interrupts_no_cleaning(tmp_path: Path) -> None:
    code = f"""{UNWINDING}
unlink = Path.unlink
def interrupted(path):
    os.kill(os.getpid(), signal.SIGTERM)
    unlink(path)
Path.unlink = interrupted
try:
    with files.atomic_write(Path("scene.ply")):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(10)
except KeyboardInterrupt:
    sys.exit(130)
"""
    assert ended(code, tmp_path) == (130, b"")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_a_signal_where_python_drops_exceptions_counts(tmp_path: Path) -> None:
    code = f"""{UNWINDING}
class Freed:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(10)
with files.atomic_write(Path("scene.ply")):
    Freed()
    time.sleep(60)
"""
    assert ended(code, tmp_path) == (130, b"")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_ctrl_c_while_the_program_is_loaded_is_quiet(tmp_path: Path) -> None:
    kill = "import os, signal, time; os.kill(os.getpid(), signal.SIGINT); time.sleep(10)"
    (tmp_path / "click.py").write_text(kill)  # `python -m` looks here first
    assert ended("", tmp_path, "-m", "styl3r_cli") == (-signal.SIGINT, b"")


def test_a_failed_run_waits_for_no_thread(tmp_path: Path) -> None:
    code = """
import threading, time
from styl3r_cli import main
threading.Thread(target=time.sleep, args=(60,)).start()
main.main(["info", "missing.ply"])
"""
    status, out = ended(code, tmp_path)
    assert status == 3
    assert out.startswith(b"styl3r: error: missing.ply")


def test_notes_are_told_once_and_kept(capsys: pytest.CaptureFixture[str]) -> None:
    for quiet in (False, True):
        told = console.Console(quiet)
        told.note("one\tnote")
        told.note("one\tnote")
        assert told.notes == ["one\tnote"]
        out, err = capsys.readouterr()
        assert out == ""
        assert err == ("" if quiet else "styl3r: one\\tnote\n")


def test_stages_are_timed_and_silent_without_a_terminal(
    capsys: pytest.CaptureFixture[str],
) -> None:
    told = console.Console()
    for _ in range(2):
        with told.stage("work", 2) as advance:
            time.sleep(0.02)
            advance()
    assert list(told.timings) == ["work"]
    assert 0.04 <= told.timings["work"] < 5
    assert capsys.readouterr() == ("", "")


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals")
@pytest.mark.parametrize(("seconds", "shown"), [(0.1, False), (0.6, True)])
def test_long_stages_show_progress_on_a_terminal(seconds: float, shown: bool) -> None:
    code = (
        "import time; from styl3r_cli import console\n"
        "console.PATIENCE, console.REDRAW = 0.3, 0.1\n"
        f"with console.Console().stage('video', 4) as step: step(); time.sleep({seconds})"
    )
    reader, terminal = os.openpty()
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "80"}
    subprocess.run([sys.executable, "-c", code], stderr=terminal, check=True, env=environment)
    os.close(terminal)
    try:
        text = os.read(reader, 10000).decode()
    except OSError:  # what Linux answers when nothing was written
        text = ""
    finally:
        os.close(reader)
    assert ("video [######" in text) is shown
    if shown:
        assert "25%" in text
        assert text.endswith(console.CLEAR_LINE)  # nothing is left behind


def test_progress_fits_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    assert len(console.progress_line("a long name " * 5, 1, 10, 3.0)) == 29
    assert console.progress_line("model", 0, 0, 2.4) == "model ... 2 s"


def test_no_color(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(console, "is_terminal", lambda: True)
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert console.painted("x", console.RED) == f"{console.RED}x{console.RESET}"
    monkeypatch.setenv("NO_COLOR", "1")
    assert console.painted("x", console.RED) == "x"
