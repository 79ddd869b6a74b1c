"""`styl3r render`: every format, into files and through pipes, whole or not at all."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from two_cameras import Run, video_frames


@pytest.mark.parametrize("suffix", ["jpg", "webm", "webp", "gif", "y4m"])
def test_other_formats_by_their_name(run: Run, scene: Path, tmp_path: Path, suffix: str) -> None:
    target = tmp_path / (f"%d.{suffix}" if suffix == "jpg" else f"a.{suffix}")
    assert run(scene, "--frames", 3, "--size", "66x34", "-o", target) == (0, "")
    if suffix == "jpg":
        assert {p.name for p in tmp_path.glob("*.jpg")} == {"0.jpg", "1.jpg", "2.jpg"}
        picture = np.asarray(Image.open(tmp_path / "1.jpg"))
    else:
        import av

        if suffix == "webp":
            picture = np.asarray(Image.open(target).convert("RGB"))
        else:
            with av.open(str(target)) as container:
                frames = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
            assert len(frames) == 3
            picture = frames[0]
    assert picture.shape == (34, 66, 3)


@pytest.mark.parametrize("form", ["y4m", "rgb", "png", "webm"])
def test_a_pipe_gets_what_a_file_gets(scene: Path, tmp_path: Path, form: str) -> None:
    command = [sys.executable, "-m", "styl3r_cli", "render", str(scene), "--frames", "2"]
    command += ["--size", "64x48", "--format", form, "--threads", "1", "-o"]
    piped = subprocess.run([*command, "-"], capture_output=True, check=True)
    if form == "rgb":
        assert piped.stderr == b"styl3r: raw rgb24, 64x48, 24 frames per second\n"
        assert len(piped.stdout) == 2 * 64 * 48 * 3
    else:
        assert piped.stderr == b""
    if form != "png":
        subprocess.run([*command, str(tmp_path / f"a.{form}")], capture_output=True, check=True)
        assert (tmp_path / f"a.{form}").read_bytes() == piped.stdout


def test_the_note_on_raw_pixels_counts_both_pictures(run: Run, scene: Path, tmp_path: Path) -> None:
    target = tmp_path / "a.rgb"
    size = ("--frames", 1, "--size", "64x48", "--show", "both")
    code, err = run(scene, *size, "--format", "rgb", "-o", target)
    assert (code, err) == (0, "styl3r: raw rgb24, 128x48, 24 frames per second\n")
    assert target.stat().st_size == 128 * 48 * 3


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX pipes")
def test_a_reader_that_leaves_ends_the_run_quietly(scene: Path, tmp_path: Path) -> None:
    """As after `| head`: the conventional code, no words, and long before all frames are drawn."""
    command = [sys.executable, "-m", "styl3r_cli", "render", str(scene), "--frames", "5000"]
    command += ["--size", "64x48", "--format", "y4m", "-o", "-"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, cwd=tmp_path) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.read(9) == b"YUV4MPEG2"
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(timeout=60) == 141
    assert [path.name for path in tmp_path.iterdir()] == ["scene.ply"]


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
@pytest.mark.parametrize("target", ["a.mp4", "a.webm", "a.gif"])
def test_ctrl_c_while_a_video_is_written_leaves_no_part_of_it(
    scene: Path, tmp_path: Path, target: str
) -> None:
    # Frames so large that a minute would not be enough for all: the signal comes before the last.
    command = [sys.executable, "-m", "styl3r_cli", "render", str(scene), "--frames", "5000"]
    command += ["--size", "640x480", "-o", target]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, cwd=tmp_path) as process:
        deadline = time.monotonic() + 60
        while not list(tmp_path.glob(f".styl3r-*{target[1:]}")) and time.monotonic() < deadline:
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    # Python ends by the signal itself if that came while it ran a string as code, as numba does
    # to compile; a shell calls either 130.
    assert process.returncode in (130, -signal.SIGINT)
    assert (out, err) == (b"", b"")
    assert [path.name for path in tmp_path.iterdir()] == ["scene.ply"]


def test_pipes_at_both_ends(scene: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "styl3r_cli", "render", "-", "--frames", "2", "-o", "-"]
    with scene.open("rb") as file:
        result = subprocess.run(command, stdin=file, capture_output=True, check=True)
    assert result.stderr == b""
    (tmp_path / "v.mp4").write_bytes(result.stdout)
    assert len(video_frames(tmp_path / "v.mp4")) == 2


@pytest.mark.parametrize("name", ["%d", "%d.frame"])
def test_the_format_that_is_asked_for_is_written_under_a_name_that_says_none(
    run: Run, scene: Path, tmp_path: Path, name: str
) -> None:
    words = ("--frames", 2, "--size", 16, "--background", "transparent", "--format", "png")
    code, error = run(scene, "-o", tmp_path / "png" / name, *words)
    assert code == 0, error
    for path in (tmp_path / "png").iterdir():
        with Image.open(path) as picture:
            assert (picture.format, picture.mode) == ("PNG", "RGBA")
    words = ("--frames", 1, "--size", 16, "--format", "jpg")
    assert run(scene, "-o", tmp_path / "a.picture", *words)[0] == 0
    with Image.open(tmp_path / "a.picture") as picture:
        assert picture.format == "JPEG"
