"""What comes through pipes without an end, and headers that are too long: refused, and soon."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from styl3r_cli import limits, main
from styl3r_cli.formats import write_scene
from styl3r_cli.gaussians import Gaussians

linux = pytest.mark.skipif(sys.platform != "linux", reason="limits and <(...) are Unix's")
ADDRESSES = 3_000_000  # kB: ends what reads on
HEADER = "printf 'ply\\nformat ascii 1.0\\n'"


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    one = np.ones((1, 3), np.float32)
    write_scene(Path("s.ply"), Gaussians(one, one, np.eye(4, dtype=np.float32)[:1], one[:, 0], one))
    return tmp_path


ENDLESS = [
    ("cat /dev/zero | $S info -", "not a scene in a known format"),
    ("cat /dev/zero | $S convert - x.ply --from spz", "not an .spz file"),
    ("cat /dev/zero | $S compact - -o x.ply", "not a scene in a known format"),
    ("cat /dev/zero | $S render - -o x.mp4", "not a scene in a known format"),
    ("$S render s.ply -o x.png --compare <(yes)", "not a scene in a known format"),
    ("yes ply | $S info -", "the PLY header does not end within 1 MB"),
    (f"({HEADER}; yes 'comment a') | $S info -", "the PLY header does not end within 1 MB"),
    ("yes | $S stylize - -s $PHOTO -o x.ply", "-: larger than 64 MB, the most that is read of a"),
    ("$S render s.ply -o x.mp4 --cameras <(yes '[')", "larger than 256 MB, the most that is read"),
    ("$S stylize $PHOTO $PHOTO -o x.ply -s <(cat /dev/zero)", "not a picture that can be read"),
]


@linux
@pytest.mark.parametrize(("line", "words"), ENDLESS)
def test_no_end_is_waited_for(here: Path, photos: list[Path], line: str, words: str) -> None:
    environment = os.environ | {"S": f"{sys.executable} -m styl3r_cli", "PHOTO": str(photos[0])}
    script = f"ulimit -v {ADDRESSES}; set -o pipefail; {line}"
    shell = {"env": environment, "capture_output": True, "check": False, "timeout": 60}
    done = subprocess.run(["bash", "-c", script], **shell)  # type: ignore[call-overload]
    errors = [each for each in done.stderr.decode().splitlines() if "styl3r: error" in each]
    assert (done.returncode, len(errors)) == (3, 1)
    assert words in errors[0]
    assert not list(here.glob("x.*"))


@linux
def test_a_scene_without_an_end_stops_at_half_of_the_memory(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(limits, "memory", lambda: 20 << 20)
    writer = subprocess.Popen(["bash", "-c", "cat s.ply; cat /dev/zero"], stdout=subprocess.PIPE)
    assert writer.stdout is not None
    with writer, writer.stdout as pipe:
        assert main.run(["info", f"/dev/fd/{pipe.fileno()}"]) == 3
    err = capsys.readouterr().err
    assert "larger than 10 MB, half of this machine's memory" in err
    assert err.count("\n") == 1


def test_a_file_larger_than_the_memory_is_named(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(limits, "memory", lambda: 100)
    assert main.run(["info", "s.ply"]) == 1
    assert capsys.readouterr().err == "styl3r: error: out of memory: s.ply does not fit\n"


def test_a_header_that_is_too_long_says_so(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of a whole file: nothing is cut off."""
    camera = "64 64 60 60 32 32 1 0 0 0 0 1 0 0 0 0 1 0"
    comments = "".join(f"comment camera.{index}: {camera}\n" for index in range(20_000))
    text = Path("s.ply").read_bytes()
    Path("s.ply").write_bytes(text.replace(b"element", comments.encode() + b"element", 1))
    assert main.run(["info", "s.ply"]) == 3
    assert "the PLY header does not end within 1 MB" in capsys.readouterr().err
    Path("s.ply").write_bytes(text[:100])
    assert main.run(["info", "s.ply"]) == 3
    assert "has no end; is the file cut off?" in capsys.readouterr().err
