"""Where results go: each in a file of its own, never unseen, and pipes that have names."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from styl3r_cli import main, pipes
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.stored import cameras_to_metadata
from styl3r_cli.cameras.transforms import write_transforms
from styl3r_cli.formats import read_scene, write_scene
from styl3r_cli.gaussians import Gaussians

Run = Callable[..., tuple[int, bytes, str]]
CAMERA = Camera(np.eye(4), 20, 20, 12, 12, 24, 24)
linux = pytest.mark.skipif(sys.platform != "linux", reason="pipes with names are Unix's")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder that commands run in, with a scene and its cameras."""
    monkeypatch.chdir(tmp_path)
    three = np.array([[0, 0, 2], [0.2, 0, 2], [0, 0.2, 3]], np.float32)
    turns = np.tile(np.float32([1, 0, 0, 0]), (3, 1))
    scene = Gaussians(three, np.full_like(three, 0.1), turns, np.ones(3), np.abs(three) / 4)
    write_scene(Path("s.ply"), scene, cameras_to_metadata([CAMERA]))
    write_transforms(Path("cams.json"), [CAMERA], ["0.png"])
    return tmp_path


def started(*arguments: object, **options: object) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-m", "styl3r_cli", *map(str, arguments)]
    settings = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "timeout": 120, **options}
    return subprocess.run(command, **settings)  # type: ignore[call-overload,no-any-return]


TWICE = [
    "render s.ply -o a.json --format gif --save-path a.json",
    "render s.ply -o a.json --format gif --save-path ./a.json",
    "render s.ply -o a.json --format gif --save-path link.json",
    "render s.ply --frames 3 -o %d.json --format png --save-path 2.json",
    "render s.ply --cameras 0.png -o %d.png",
    "render s.ply --path 0.png -o %d.png",
    "reconstruct photos -o a.ply --video a.webp --preview b.png --cameras-out cams.json"
    " --cameras cams.json",
    "reconstruct photos -o a.ply --cameras-out {model}/manifest.json",
    "bench render cams.json --json cams.json",
]


@pytest.mark.parametrize("line", TWICE)
def test_no_file_is_two_things(
    here: Path, photos: list[Path], tiny_model: Path, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    if sys.platform != "win32":
        Path("link.json").symlink_to("a.json")
    for name in ("0.png", "1.png"):
        Path(name).write_bytes(Path("cams.json").read_bytes())
    words = line.format(model=tiny_model).split()
    if words[0] == "reconstruct":
        words += ["--model", str(tiny_model), "--fov", "50"]
    before = {path: path.read_bytes() for path in here.rglob("*") if path.is_file()}
    assert main.run(words) == 2
    err = capsys.readouterr().err
    assert "is also an input" in err or "would be two results" in err
    assert {path: path.read_bytes() for path in here.rglob("*") if path.is_file()} == before


NO_JSON = ["render s.ply -o a.gif --save-path s.ply", "bench render --json s.ply"]


@pytest.mark.parametrize("line", NO_JSON)
def test_json_replaces_json_only(here: Path, line: str, capsys) -> None:
    """`--json` takes no file in other commands: a scene may be named after it by mistake."""
    before = Path("s.ply").read_bytes()
    assert main.run(line.split()) == 2
    assert "must end in .json" in capsys.readouterr().err
    assert Path("s.ply").read_bytes() == before


def test_cameras_without_a_size_take_the_frames(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = json.loads(Path("cams.json").read_text())
    for entry in content["frames"]:
        for key in ("w", "h", "cx", "cy"):
            entry.pop(key)
    Path("bare.json").write_text(json.dumps(content))
    line = "render s.ply --cameras {}.json -o {}.png -q --size 24x24"
    assert main.run(["render", "s.ply", "--cameras", "bare.json", "-o", "x.png"]) == 3
    assert "give render a --size" in capsys.readouterr().err
    for name in ("bare", "cams"):
        assert main.run(line.format(name, name).split()) == 0
    assert Path("bare.png").read_bytes() == Path("cams.png").read_bytes()


@linux
def test_a_report_and_a_result_in_one_file(here: Path) -> None:
    """A shell has emptied the file by then; but the report is not lost silently, too."""
    with Path("o.ply").open("wb") as out:
        done = started("compact", "s.ply", "-o", "o.ply", "--json", stdout=out)
    assert done.returncode == 2


PRINTING = [
    "info s.ply --json",
    "info s.ply",
    "compact s.ply -o o.ply --json",
    "completion bash",
    "man",
    "--help",
    "--version",
    "render --help",
    "bench render s.ply --sizes 16 --repeats 1",
    "convert s.ply -",
]


@linux
@pytest.mark.parametrize("line", PRINTING)
def test_standard_output_that_is_closed(here: Path, line: str) -> None:
    """Nothing could be told, and success would claim that it was."""
    done = started(*line.split(), preexec_fn=lambda: os.close(1))
    assert (done.returncode, done.stderr.count(b"\n")) == (6, 1)
    assert b"standard output: it is closed" in done.stderr
    assert not Path("o.ply").exists()


@linux
def test_standard_output_that_is_for_reading(here: Path) -> None:
    with Path("s.ply").open("rb") as file:
        done = started("info", "s.ply", stdout=file)
    assert (done.returncode, done.stderr.count(b"\n")) == (6, 1)


@pytest.mark.parametrize("name", ["xml", "JSON", " "])
def test_a_log_of_no_known_format(
    here: Path, name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("STYL3R_LOG", name)
    assert main.run(["info", "s.ply", "-q"]) == 2
    assert "text or json" in capsys.readouterr().err


EMPTY = ["-s=", "--model=", "--cameras=", "--video="]


@pytest.mark.parametrize("option", EMPTY)
def test_empty_names(photos: list[Path], style: Path, tmp_path: Path, capsys, option: str) -> None:
    words = ["stylize", *map(str, photos), "-s", str(style), "-o", str(tmp_path / "a.ply")]
    name = "" if option == "-s=" else option
    words += ["-s", ""] if not name else [name]
    assert main.run(words) == 2
    assert "the file name is empty" in capsys.readouterr().err


@pytest.fixture
def hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody comes to these pipes."""
    monkeypatch.setattr(pipes, "PATIENCE", 0.2)


LONELY = [
    ("info p.ply", 3),
    ("convert p.spz o.ply", 3),
    ("convert s.ply p.ply", 6),
    ("compact p.ply -o o.ply", 3),
    ("render p.ply -o o.png", 3),
    ("render s.ply -o o.png --cameras p.json", 3),
    ("render s.ply -o o.png --path p.json", 3),
    ("render s.ply -o o.png --compare p.ply", 3),
    ("stylize photos -s p.jpg -o o.ply", 3),
    ("reconstruct photos -o o.ply --cameras p.json", 3),
    ("reconstruct p.jpg photos/0.png -o o.ply", 3),
    ("reconstruct photos -o o.ply --model m", 4),
]


@linux
@pytest.mark.parametrize(("line", "expected"), LONELY)
def test_pipes_with_nobody_at_the_other_end(
    here: Path,
    hurry: None,
    photos: list[Path],
    tiny_model: Path,
    capsys: pytest.CaptureFixture[str],
    line: str,
    expected: int,
) -> None:
    Path("m").mkdir()
    for name in ("p.ply", "p.spz", "p.jpg", "p.json", "m/manifest.json"):
        os.mkfifo(name)
    words = line.split()
    if words[0] in ("stylize", "reconstruct"):
        words += ["--fov", "50"] + ([] if "--model" in words else ["--model", str(tiny_model)])
    assert main.run(words) == expected
    *_, error = capsys.readouterr().err.splitlines()
    assert "a pipe" in error
    assert not Path("o.ply").exists()


@linux
def test_what_a_shell_gives_as_a_file(
    here: Path, run: Run, photos: list[Path], style: Path
) -> None:
    """`<(program)` is a pipe called /dev/fd/63: scenes, cameras and styles are read from it."""

    def through_pipe(path: Path) -> str:
        source, sink = os.pipe()
        os.set_inheritable(source, True)
        data = path.read_bytes()
        threading.Thread(target=lambda: (os.write(sink, data), os.close(sink))).start()
        return f"/dev/fd/{source}"

    scene, cameras = through_pipe(Path("s.ply")), through_pipe(Path("cams.json"))
    assert main.run(["render", scene, "--cameras", cameras, "-o", "a.png", "-q"]) == 0
    assert main.run(["convert", through_pipe(Path("s.ply")), "b.ply", "-q"]) == 0
    assert Path("b.ply").read_bytes() == Path("s.ply").read_bytes()
    fov = ("--fov", "50", "-q", "--all")
    assert run("stylize", *photos, "-s", style, "-o", "c.ply", *fov)[0] == 0
    assert run("stylize", *photos, "-s", through_pipe(style), "-o", "d.ply", *fov)[0] == 0
    np.testing.assert_array_equal(
        read_scene(Path("c.ply")).gaussians.colours, read_scene(Path("d.ply")).gaussians.colours
    )


THROUGH = [
    ("$S convert s.ply >(cat > got) --to ply -q", "s.ply"),
    ("$S convert s.ply /dev/stdout --to ply -q | cat > got", "s.ply"),
    ("$S render s.ply --frames 3 -o >(cat > got) --format y4m -q", "a.y4m"),
    ("$S render s.ply --frames 3 -o >(cat > got) --format mp4 -q", "a.mp4"),
    ("$S render s.ply --frames 1 -o >(cat > got) --format png -q", "a.png"),
    ("cat p.mp4 > got & $S render s.ply --frames 3 -o p.mp4 -q", "a.mp4"),
]


@linux
@pytest.mark.parametrize(("line", "same"), THROUGH)
def test_results_go_into_pipes_that_have_no_name_of_their_own(
    here: Path, line: str, same: str
) -> None:
    """`>(program)` is a pipe called /dev/fd/63, and so may /dev/stdout be: links of the system."""
    os.mkfifo("p.mp4")
    if same != "s.ply":
        count = "1" if same == "a.png" else "3"
        assert main.run(["render", "s.ply", "--frames", count, "-o", same, "-q"]) == 0
    environment = os.environ | {"S": f"{sys.executable} -m styl3r_cli"}
    # Bash does not wait for what `>(...)` started by itself.
    script = f"set -o pipefail; {line}; code=$?; sleep 0.3; exit $code"
    shell = {"env": environment, "capture_output": True, "check": False, "timeout": 120}
    result = subprocess.run(["bash", "-c", script], **shell)  # type: ignore[call-overload]
    assert (result.returncode, result.stderr) == (0, b"")
    assert Path("got").read_bytes() == Path(same).read_bytes()


@linux
def test_a_named_pipe_waits_for_its_other_end(here: Path) -> None:
    """Also for a program that comes a little later; what goes through is all of it."""
    os.mkfifo("p.ply")
    later = threading.Timer(0.3, lambda: Path("p.ply").write_bytes(Path("s.ply").read_bytes()))
    later.start()
    assert main.run(["convert", "p.ply", "a.ply", "-q"]) == 0
    got: list[bytes] = []
    threading.Timer(0.3, lambda: got.append(Path("p.ply").read_bytes())).start()
    assert main.run(["convert", "s.ply", "p.ply", "-q"]) == 0
    for thread in threading.enumerate():
        if isinstance(thread, threading.Timer):
            thread.join()
    assert got == [Path("a.ply").read_bytes()] == [Path("s.ply").read_bytes()]


def test_a_scene_that_no_camera_sees_is_not_emptied(here: Path, capsys) -> None:
    behind = np.diag([1.0, -1, -1, 1])
    write_transforms(Path("behind.json"), [replace(CAMERA, extrinsics=behind)], ["0.png"])
    words = ["compact", "s.ply", "-o", "o.ply", "--cameras", "behind.json"]
    assert main.run([*words, "--max-gaussians", "1"]) == 3
    assert "no camera" in capsys.readouterr().err
    assert not Path("o.ply").exists()


def test_decibels_are_of_what_the_file_holds(here: Path, capsys) -> None:
    """A scene in millimetres of a map has no place in .spz: that is measured, and said."""
    scene = read_scene(Path("s.ply")).gaussians
    factor = np.float32(1e12)
    far = Gaussians(
        scene.means * factor,
        scene.scales * factor,
        scene.rotations,
        scene.opacities,
        scene.colours,
    )
    write_scene(Path("far.ply"), far, cameras_to_metadata([CAMERA]))
    told = {}
    for suffix in ("ply", "spz", "points.glb"):
        assert main.run(["compact", "far.ply", "-o", f"o.{suffix}", "--json"]) == 0
        out, err = capsys.readouterr()
        told[suffix] = json.loads(out)["worst_db"]
        assert ("dB instead of 45" in err) is (suffix == "spz")
    assert told["ply"] > 45
    assert told["spz"] < 30
    assert told["points.glb"] is None


def test_what_keeps_more_is_another_format(here: Path, capsys) -> None:
    """A .ply has no place for a unit of 1e-13, and is no advice then."""
    scene = read_scene(Path("s.ply")).gaussians
    small = replace(
        scene, means=scene.means * np.float32(1e-13), scales=scene.scales * np.float32(1e-13)
    )
    write_scene(Path("small.glb"), small)
    assert main.run(["compact", "small.glb", "-o", "o.ply", "--all"]) == 0
    assert main.run(["compact", "small.glb", "-o", "o.ply"]) == 0
    assert "dB instead of 45: .ply rounds; a .glb keeps more" in capsys.readouterr().err
