"""What programs around styl3r see: lists on standard input, logs as JSON, shell completion."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from styl3r_cli import console, main
from styl3r_cli.formats import read_scene, write_scene
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.main import COMMANDS


def styl3r(*arguments: object, **options: object) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-m", "styl3r_cli", *map(str, arguments)]
    return subprocess.run(  # type: ignore[call-overload]
        command, capture_output=True, check=False, timeout=120, **options
    )


@pytest.mark.parametrize(("flags", "end"), [([], b"\n"), (["-0"], b"\0")])
def test_photos_come_through_a_pipe(
    tiny_model: Path, photos: list[Path], style: Path, tmp_path: Path, flags: list[str], end: bytes
) -> None:
    shared = ("--style", style, "--model", tiny_model, "--threads", 1, "--fov", 60, "--all")
    names = b"".join(os.fsencode(photo) + end for photo in photos)
    piped = styl3r("stylize", "-", *flags, *shared, "-o", "-", input=names)
    assert (piped.returncode, piped.stderr) == (0, b"")
    assert styl3r("stylize", *photos, *shared, "-o", tmp_path / "a.ply").returncode == 0
    assert piped.stdout == (tmp_path / "a.ply").read_bytes()
    assert len(read_scene(piped.stdout).gaussians) == 3 * 64 * 64


@pytest.mark.skipif(sys.platform == "win32", reason="pipes with names are Unix's")
def test_a_scene_goes_into_a_pipe_of_the_shell(
    tiny_model: Path, photos: list[Path], tmp_path: Path
) -> None:
    """Its name, /dev/fd/63 say, tells no format: it gets what standard output gets."""
    shared = ("--model", tiny_model, "--threads", 1, "--fov", 60, "--all", "--quiet")
    assert styl3r("reconstruct", *photos, *shared, "-o", tmp_path / "a.ply").returncode == 0
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with (tmp_path / "b.ply").open("wb") as end, subprocess.Popen(["cat", pipe], stdout=end):
        assert styl3r("reconstruct", *photos, *shared, "-o", pipe).returncode == 0
    assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "a.ply").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "data", "code", "words"),
    [
        (["-"], b"", 3, b"standard input is empty"),
        (["-"], b"\n", 3, b"no photo names"),
        (["-"], b"gone.jpg\nlost.jpg\n", 3, b"gone.jpg: no such file"),
        (["a.jpg", "-0"], b"", 2, b"add the argument -"),
    ],
)
def test_lists_that_cannot_be_used(
    tmp_path: Path, arguments: list[str], data: bytes, code: int, words: bytes
) -> None:
    result = styl3r("reconstruct", *arguments, "-o", "x.ply", input=data, cwd=tmp_path)
    assert result.returncode == code
    assert result.stderr.count(b"\n") == 1
    assert words in result.stderr


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scene of one Gaussian."""
    one = np.ones((1, 3), np.float32)
    turn = np.eye(4, dtype=np.float32)[:1]
    write_scene(tmp_path / "s.ply", Gaussians(one, one, turn, one[:, 0], one))
    return tmp_path / "s.ply"


@pytest.mark.skipif(sys.platform != "linux", reason="a shell, and devices of Linux")
@pytest.mark.parametrize(
    ("line", "code", "words"),
    [
        ("$S render s.ply --frames 1 --size 16 --format png -o - >&-", 6, "it is closed"),
        ("$S info - <&-", 2, "standard input is closed"),
        ("$S --version >/dev/full", 6, "standard output: No space left"),
        ("$S man >/dev/full", 6, "standard output: No space left"),
        ("$S info s.ply --json --no-sizes >/dev/full", 6, "standard output: No space left"),
        ("mkdir g; cd g; rmdir ../g; $S convert ../s.ply x.ply", 6, "x.ply: No such file"),
        ("$S info s.ply --no-sizes <&- >&-", 6, "standard output: it is closed"),
        ("$S info s.ply --no-sizes <&- >/dev/null", 0, ""),
        ("$S info gone.ply <&- >&- 2>&-", 3, ""),
    ],
)
def test_streams_that_are_closed_or_full(scene: Path, line: str, code: int, words: str) -> None:
    environment = os.environ | {"S": f"{sys.executable} -m styl3r_cli"}
    shell = {"cwd": scene.parent, "env": environment, "capture_output": True, "check": False}
    result = subprocess.run(["bash", "-c", line], timeout=120, **shell)  # type: ignore[call-overload]
    assert result.returncode == code
    assert words in result.stderr.decode()
    assert result.stderr.count(b"\n") == bool(words)
    assert [path.name for path in scene.parent.iterdir()] == ["s.ply"]


@pytest.mark.skipif(sys.platform != "linux", reason="needs a shell that closes streams")
def test_results_never_take_the_number_of_a_closed_stream(scene: Path, tmp_path: Path) -> None:
    code = "import sys, os; from styl3r_cli import main\n"
    code += "try: main.main(['--version'])\nexcept SystemExit: pass\n"
    code += "sys.exit(os.open('a', os.O_CREAT | os.O_WRONLY))"
    command = f'{sys.executable} -c "$CODE" <&- >&- 2>&-'
    shell = {"cwd": tmp_path, "env": os.environ | {"CODE": code}, "check": False}
    assert subprocess.run(["bash", "-c", command], timeout=60, **shell).returncode > 2  # type: ignore[call-overload]


@pytest.mark.parametrize("level", ["INFO", "debug", "V"])
def test_what_opencv_tells_stays_out_of_results(scene: Path, level: str) -> None:
    """It logs what is less than a warning on standard output, in the midst of the pixels."""
    environment = {**os.environ, "OPENCV_LOG_LEVEL": level}
    wish = ("--frames", 2, "--size", "32x16", "-o", "-", "--format", "rgb")
    result = styl3r("render", scene, *wish, env=environment)
    assert (result.returncode, len(result.stdout)) == (0, 2 * 32 * 16 * 3)


def lines(text: str) -> list[dict[str, object]]:
    return [json.loads(line) for line in text.splitlines()]


def test_logs_as_json(tiny_model: Path, photos: list[Path], style: Path, tmp_path: Path) -> None:
    arguments = ("--style", style, "--model", tiny_model, "--threads", 1, "-o", tmp_path / "a.ply")
    result = styl3r("stylize", *photos, *arguments, "--log", "json")
    assert result.returncode == 0
    assert result.stdout == b""
    events = lines(result.stderr.decode())
    (note,) = [event for event in events if event["event"] == "note"]
    assert "no focal length" in str(note["message"])
    (fact,) = [event for event in events if event["event"] == "fact"]
    assert "Gaussians kept" in str(fact["message"])
    stages = [event["stage"] for event in events if event["event"] == "stage"]
    # Cameras are found while the appearance graph runs: either may end first.
    assert stages[-2:] == ["compact", "write"]
    assert sorted(stages[-5:-2]) == ["appearance", "cameras", "structure"]
    quiet = styl3r("stylize", *photos, *arguments, "--log", "json", "--quiet")
    assert (quiet.returncode, quiet.stderr) == (0, b"")


def test_failures_as_json(tmp_path: Path) -> None:
    result = styl3r("render", "é\n.ply", "-o", "x.mp4", "--log", "json", "-q", cwd=tmp_path)
    (event,) = lines(result.stderr.decode("ascii"))
    assert (event["event"], event["exit_code"], result.returncode) == ("error", 3, 3)
    assert "é\n.ply" in str(event["message"])


def test_the_environment_decides_about_wrong_command_lines_too(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(console.LOG, "json")
    assert main.run(["render", "--nonsense"]) == 2
    (event,) = lines(capsys.readouterr().err)
    assert event["exit_code"] == 2
    monkeypatch.delenv(console.LOG)
    assert main.run(["render", "--nonsense"]) == 2
    assert capsys.readouterr().err.startswith("styl3r: error: ")


@pytest.mark.parametrize(
    ("arguments", "as_json"),
    [
        ("render --nonsense --log json", True),
        ("render --log=json --nonsense", True),
        ("render --log json", True),  # nothing to render
        ("nonsense --log json", True),
        ("render a.ply -o a.mp4 --log json --frames x", True),
        ("render --nonsense --log text", False),
        ("render --nonsense -- --log json", False),
    ],
)
def test_wrong_command_lines_as_json(
    arguments: str, as_json: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.run(arguments.split()) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("{" if as_json else "styl3r: error: ")
    if as_json:
        (event,) = lines(line)
        assert (event["event"], event["exit_code"]) == ("error", 2)


def test_progress_as_json(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(console, "PATIENCE", 0.05)
    monkeypatch.setattr(console, "_json", True)
    import time

    with console.Console().stage("video", 4) as step:
        step()
        time.sleep(0.3)
    *progress, last = lines(capsys.readouterr().err)
    assert progress
    assert progress[-1] == {"event": "progress", "stage": "video", "done": 1, "total": 4}
    assert (last["event"], last["stage"]) == ("stage", "video")


def completed(words: str) -> list[str]:
    """What bash is told for the last word of a command line."""
    count = len(words.split(" ")) - 1
    environment = os.environ | {
        "COMP_WORDS": words,
        "COMP_CWORD": str(count),
        "_STYL3R_COMPLETE": "bash_complete",
    }
    result = styl3r(env=environment)
    assert result.stderr == b""
    return result.stdout.decode().split()


@pytest.mark.parametrize(
    ("words", "answers"),
    [
        ("styl3r sty", ["plain,stylize"]),
        ("styl3r render sc", ["file,sc"]),
        ("styl3r stylize ph", ["file,ph"]),
        ("styl3r convert sc", ["file,sc"]),
        ("styl3r render x --lay", ["plain,--layout"]),
        ("styl3r render x --layout w", ["plain,wipe"]),
        ("styl3r render x --save-path a", ["file,a"]),
        ("styl3r render x --path sp", ["plain,spiral", "file,sp"]),
    ],
)
def test_shells_can_complete(words: str, answers: list[str]) -> None:
    assert completed(words) == answers


@pytest.mark.parametrize("words", [{}, {"COMP_WORDS": "styl3r x", "COMP_CWORD": "x"}])
def test_completion_by_hand_is_no_bug(words: dict[str, str]) -> None:
    result = styl3r(env=os.environ | {"_STYL3R_COMPLETE": "bash_complete"} | words)
    assert result.returncode == 2
    assert b"is for shells" in result.stderr


@pytest.mark.parametrize("wish", ["x", "bash_x", "_"])
def test_completion_of_no_shell_says_so(wish: str) -> None:
    result = styl3r("info", "x.ply", env=os.environ | {"_STYL3R_COMPLETE": wish})
    assert (result.returncode, result.stderr.count(b"\n")) == (2, 1)
    assert b"is for shells" in result.stderr


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_scripts_call_the_program(shell: str) -> None:
    result = styl3r("completion", shell)
    assert (result.returncode, result.stderr) == (0, b"")
    assert f"_STYL3R_COMPLETE={shell}_complete".encode() in result.stdout


@pytest.mark.skipif(sys.platform == "win32", reason="needs bash")
def test_bash_accepts_its_script() -> None:
    script = styl3r("completion", "bash").stdout
    check = subprocess.run(["bash", "-n"], input=script, capture_output=True, check=False)
    assert (check.returncode, check.stderr) == (0, b"")


def test_every_command_has_examples(capsys: pytest.CaptureFixture[str]) -> None:
    for name in COMMANDS:
        words = ["bench", "render"] if name == "bench" else [name]  # a group of commands
        assert main.run([*words, "--help"]) == 0
        assert (
            f"styl3r {' '.join(words)} "
            in capsys.readouterr().out.split("Options:")[0].split("\n", 1)[1]
        )
