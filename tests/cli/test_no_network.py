"""Nothing is downloaded and nothing is told to anybody: no command opens a connection."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

PROGRAM = """
import os, sys
def watch(event, arguments):
    if event in ("socket.connect", "socket.getaddrinfo", "socket.bind", "socket.sendto"):
        os.write(2, f"{event} {arguments}".encode())
        os._exit(99)
sys.addaudithook(watch)
if sys.argv[1] == "connect":
    import socket
    socket.create_connection(("127.0.0.1", 9))
from styl3r_cli.main import main
main(sys.argv[1:])
"""


def watched(*arguments: object) -> tuple[int, bytes]:
    command = [sys.executable, "-c", PROGRAM, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, check=False, timeout=120)
    return done.returncode, done.stderr


def test_the_watch_sees_connections() -> None:
    assert watched("connect")[0] == 99


def test_no_connection_is_made(
    tiny_model: Path, photos: list[Path], style: Path, tmp_path: Path
) -> None:
    scene = tmp_path / "a.ply"
    model = ("--model", tiny_model, "--threads", 1, "--fov", 50)
    assert watched("stylize", *photos, "-s", style, "-o", scene, *model) == (0, b"")
    frame = ("--frames", 1, "--size", 32, "-o", tmp_path / "a.png")
    assert watched("render", scene, *frame) == (0, b"")
    assert watched("convert", scene, tmp_path / "a.splat", "-q") == (0, b"")


# Where these are set, onnxruntime's telemetry takes the run for a test and does nothing anyway.
TESTS = ("CI", "GITHUB_ACTIONS", "TF_BUILD", "ORT_RUNNING_UNIT_TESTS", "ORT_DISABLE_TELEMETRY")


def test_no_library_keeps_files_of_its_own(
    tiny_model: Path, photos: list[Path], style: Path, tmp_path: Path
) -> None:
    """Libraries in C are not watched above; telemetry begins with an identifier in the cache."""
    home = tmp_path / "home"
    home.mkdir()
    places = dict.fromkeys(("HOME", "TMPDIR", "XDG_CACHE_HOME", "XDG_DATA_HOME"), str(home))
    environment = {name: text for name, text in os.environ.items() if name not in TESTS} | places
    command = [sys.executable, "-m", "styl3r_cli", "stylize", *photos, "-s", style, "--fov", "50"]
    command += ["--model", tiny_model, "--threads", "1", "-o", tmp_path / "a.ply"]
    subprocess.run(list(map(str, command)), env=environment, check=True, timeout=120)
    assert list(home.rglob("*")) == []
