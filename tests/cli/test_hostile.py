"""Names and files made to break a reader: one line, the right code, nothing written."""

from __future__ import annotations

import json
import os
import re
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from styl3r_cli import main
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.camera_path import read_camera_path
from styl3r_cli.cameras.json_values import FARTHEST, LARGEST_SIDE
from styl3r_cli.cameras.stored import cameras_from_metadata, cameras_to_metadata
from styl3r_cli.cameras.transforms import read_transforms
from styl3r_cli.errors import InputError
from styl3r_cli.formats import MODULES, encode_scene, read_scene, write_scene
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.photos.decode import decode

Run = Callable[..., tuple[int, bytes, str]]


def one_gaussian() -> Gaussians:
    one = np.ones((1, 3), np.float32)
    return Gaussians(one, one, np.eye(4, dtype=np.float32)[:1], one[:, 0], one)


LONG = "a" * 300  # file systems take 255 bytes

NAMES = [
    (f"reconstruct {LONG} -o x.ply", 3, "too long"),
    (f"stylize photos -s {LONG}.png -o x.ply", 3, "too long"),
    (f"stylize photos -s style.jpg -o {LONG}.ply", 6, "too long"),
    ("reconstruct ~nobody-here/a -o x.ply", 3, "~nobody-here/a: not found"),
    ("stylize photos -s ~nobody-here/a -o x.ply", 3, "no such style"),
    ("stylize photos -s style.jpg -o ~nobody-here/x.ply", 6, "does not exist"),
    ("reconstruct photos -o x.ply --video ~nobody-here/x.mp4", 6, "does not exist"),
    ("reconstruct loop -o x.ply", 3, "loop: this link"),
    ("stylize photos -s loop -o x.ply", 3, "no such style"),
    ("reconstruct photos -o loop.ply", 6, "a loop of links"),
    ("reconstruct photos -o x.ply --cameras loop", 3, "symbolic links"),
]


@pytest.mark.skipif(sys.platform == "win32", reason="links and ~user are Unix's")
@pytest.mark.parametrize(("arguments", "expected", "words"), NAMES)
def test_names_that_no_file_can_have(
    run: Run,
    photos: list[Path],
    style: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: str,
    expected: int,
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("loop", "loop.ply"):
        Path(name).symlink_to(name)
    before = sorted(tmp_path.rglob("*"))
    code, out, err = run(*arguments.split(), "--fov", "50")
    assert (code, out, err.count("\n")) == (expected, b"", 1)
    assert words in err
    assert "bug" not in err
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.skipif(sys.platform != "linux", reason="other systems refuse such names")
def test_names_with_spaces_line_breaks_and_bytes_that_are_no_text(
    run: Run, photos: list[Path], style: Path, tmp_path: Path
) -> None:
    folder = tmp_path / os.fsdecode(b"a \xff\n;b")
    folder.mkdir()
    odd = [folder / os.fsdecode(b"\xfe \n'%d.png" % index) for index in range(2)]
    for photo, name in zip(photos, odd, strict=False):
        photo.rename(name)
    style = style.rename(tmp_path / os.fsdecode(b"\xfd.png"))
    outputs = {"-o": "s.ply", "--cameras-out": "c.json"}
    named = [part for option, name in outputs.items() for part in (option, folder / name)]
    code, out, err = run("stylize", folder, "-s", style, *named, "--json", "--fov", "50")
    assert (code, err.count("\n")) == (0, err.count("styl3r: "))  # notes are a line each
    assert json.loads(out)["styles"][0]["path"] == str(style)
    written = read_transforms(folder / "c.json")
    assert [os.fsencode(name) for name in written.file_paths] == [
        os.fsencode(photo.name) for photo in odd
    ]
    again = ("-o", folder / "t.ply", "--cameras", folder / "c.json")
    code, _, err = run("reconstruct", folder, *again)
    assert (code, "no camera" in err) == (0, False)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems refuse such names")
def test_scenes_of_such_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    odd = [tmp_path / os.fsdecode(b"a \xff\n\x1b[1m%d" % index) for index in range(2)]
    scene, other = odd[0].with_suffix(".ply"), odd[1].with_suffix(".spz")
    write_scene(scene, one_gaussian())
    assert main.run(["convert", str(scene), str(other)]) == 0
    assert main.run(["info", str(other), "--no-sizes", "--json"]) == 0
    out, _ = capsys.readouterr()
    assert json.loads(out)["path"] == str(other)  # the very name, for whoever opens it
    assert main.run(["info", str(other), "--no-sizes"]) == 0
    assert main.run(["info", f"{other}.gone.spz"]) == 3
    out, err = capsys.readouterr()
    assert "\x1b" not in out + err
    assert err.count("\n") == 1


# {bad} is what cannot be read; every place of a command where a file can be named.
READERS = [
    ("reconstruct {bad}.png photos/0.png -o x.ply", 3),
    ("stylize photos -s {bad}.png -o x.ply", 3),
    ("reconstruct photos -o x.ply --cameras {bad}.json", 3),
    ("reconstruct photos -o x.ply --model {bad}", 4),
    ("info {bad}.ply", 3),
    ("convert {bad}.spz x.ply", 3),
    ("compact {bad}.ply -o x.ply", 3),
    ("render {bad}.ply -o x.png", 3),
    ("render good.ply -o x.png --cameras {bad}.json", 3),
    ("render good.ply -o x.png --path {bad}.json", 3),
    ("render good.ply -o x.png --compare {bad}.ply", 3),
]


def device(path: Path) -> None:
    """Read to its end, it would fill the memory."""
    path.symlink_to("/dev/zero")


def failing_file(path: Path) -> None:
    """Looks like a file and cannot be read; what root may read, too."""
    path.symlink_to("/proc/self/mem")


def forbidden(path: Path) -> None:
    path.touch(mode=0o000)


def loop(path: Path) -> None:
    path.symlink_to(path.name)


def nothing(path: Path) -> None:
    path.touch()


@pytest.mark.skipif(sys.platform != "linux", reason="devices and links are Linux's")
@pytest.mark.parametrize("make", [device, failing_file, forbidden, loop, nothing])
@pytest.mark.parametrize(("arguments", "expected"), READERS)
def test_files_that_cannot_be_read(
    photos: list[Path],
    style: Path,
    tiny_model: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    make: Callable[[Path], None],
    arguments: str,
    expected: int,
) -> None:
    monkeypatch.chdir(tmp_path)
    write_scene(Path("good.ply"), one_gaussian())
    Path("bad").mkdir()
    for name in ("bad.png", "bad.json", "bad.ply", "bad.spz", "bad/manifest.json"):
        make(tmp_path / name)
    before = sorted(tmp_path.rglob("*"))
    words = arguments.format(bad="bad").split()
    if words[0] in ("stylize", "reconstruct"):
        words += ["--fov", "50"] + ([] if "--model" in words else ["--model", str(tiny_model)])
    assert main.run(words) == expected
    *notes, error = capsys.readouterr().err.splitlines()
    assert "bad" in error + "".join(notes)
    assert "a bug" not in error
    assert all("error" not in note for note in notes)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("suffix", MODULES)
def test_scenes_under_a_wrong_suffix(tmp_path: Path, suffix: str) -> None:
    """One clear line, or what is in it: never something else."""
    scene = one_gaussian()
    data = encode_scene(scene, {}, suffix).data
    for other in MODULES:
        path = tmp_path / f"a{other}"
        path.write_bytes(data)
        if other == suffix != ".points.glb":  # which is only written
            np.testing.assert_allclose(read_scene(path).gaussians.means, scene.means, atol=1e-3)
            continue
        with suppress(InputError):  # a .glb is one in both of its suffixes, as a .ply is
            np.testing.assert_allclose(read_scene(path).gaussians.means, scene.means, atol=1e-3)


@pytest.mark.parametrize("suffix", [".gif", ".png", ".webp", ".tiff"])
def test_of_an_animation_the_first_frame_is_the_photo(tmp_path: Path, suffix: str) -> None:
    frames = [Image.new("RGB", (40, 30), colour) for colour in ("#ff0000", "#00ff00", "#0000ff")]
    path = tmp_path / f"a{suffix}"
    lossless = {"lossless": True} if suffix == ".webp" else {}
    frames[0].save(path, save_all=True, append_images=frames[1:], **lossless)
    assert (np.asarray(decode(path).image) == (255, 0, 0)).all()
    renamed = path.rename(tmp_path / "a.jpg")  # what it is counts, not what it is called
    assert (np.asarray(decode(renamed).image) == (255, 0, 0)).all()


@pytest.mark.parametrize("text", ["[" * 200_000, '{"a":' * 200_000, '"' + "9" * 5000 + '"', "\xff"])
def test_manifests_that_break_parsers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], photos: list[Path], text: str
) -> None:
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "manifest.json").write_bytes(text.encode("latin-1"))
    words = ["reconstruct", str(photos[0].parent), "-o", str(tmp_path / "x.ply"), "--fov", "50"]
    assert main.run([*words, "--model", str(tmp_path / "m")]) == 4
    err = capsys.readouterr().err
    assert "manifest.json: " in err
    assert "a bug" not in err


def transforms(**changes: Any) -> bytes:
    frame = {"file_path": "0.png", "transform_matrix": np.eye(4).tolist()}
    return json.dumps({"w": 64, "h": 64, "fl_x": 60, "frames": [frame]} | changes).encode()


def placed(matrix: Any) -> dict[str, Any]:
    return {"frames": [{"transform_matrix": matrix}]}


OVERFLOWING = np.eye(4)
OVERFLOWING[:2, :2] = [[1e200, 1e200], [-1e200, 1e200]]  # its product with itself has NaN
FAR = np.eye(4)
FAR[0, 3] = 1e300


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"w": 10**400}, "'w' is 1000000000000000000000000000000000000000..., not a number"),
        ({"w": list(range(10**4))}, "not a number"),
        ({"w": 1e300}, "not a picture's size"),
        ({"w": LARGEST_SIDE + 1}, "not a picture's size"),
        ({"fps": -(10**400)}, "not a number"),
        ({"fps": 1e300}, "at most 1000 frames"),
        ({"fl_x": 1e300}, "not a focal length"),
        ({"fl_x": 1e-300}, "not a focal length"),
        ({"fl_x": -60}, "not a focal length"),
        ({"fl_y": 1e9}, "not a focal length"),
        ({"cx": 1e300}, "'cx' is 1e+300, more than 100 frames of 64 pixels outside of the frame"),
        ({"cy": -6401}, "'cy' is -6401, more than 100 frames of 64 pixels outside of the frame"),
        ({"cx": 6465}, "'cx' is 6465, more than 100"),
        ({"camera_model": "x" * 10**5}, "no perspective camera"),
        (placed([[10**400, 0, 0, 0]] * 4), "not a 4x4 matrix"),
        (placed(OVERFLOWING.tolist()), "no rigid motion"),
        (placed(np.diag([np.nan, 1, 1, 1]).tolist()), "not a 4x4 matrix"),
        (placed(np.diag([1.01, 1, 1, 1]).tolist()), "no rigid motion"),
        (placed(np.diag([1, 1, -1, 1]).tolist()), "mirrors"),
        (placed(FAR.tolist()), "too far out"),
    ],
)
def test_camera_files_beyond_numbers(changes: dict[str, Any], words: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # none reaches the user's screen
        with pytest.raises(InputError, match=re.escape(words)) as caught:
            read_transforms(transforms(**changes))
    assert len(str(caught.value)) < 200


def test_crops_have_their_principal_point_outside() -> None:
    (camera,) = read_transforms(transforms(cx=-6400, cy=6464)).cameras
    assert (camera.cx, camera.cy) == (-6400, 6464)
    assert len(cameras_from_metadata(cameras_to_metadata([camera]))) == 1


@pytest.mark.parametrize("command", ["reconstruct {photos} -o x.ply", "render s.ply -o x.png"])
def test_a_camera_file_with_an_absurd_principal_point_is_named(
    tmp_path: Path, run: Run, photos: list[Path], monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write_scene(Path("s.ply"), one_gaussian())
    Path("cx.json").write_bytes(transforms(cx=1e9))
    words = command.format(photos=photos[0].parent).split()
    if words[0] == "render":
        assert main.run([*words, "--cameras", "cx.json"]) == 3
    else:
        code, _, err = run(*words, "--cameras", "cx.json")
        assert (code, err.count("\n")) == (3, 1)
        assert "cx.json: frame 1: 'cx' is 1e+09, more than" in err
    assert not list(tmp_path.glob("x.*"))


@pytest.mark.parametrize("width", [10**400, 1e300, LARGEST_SIDE + 1, 0.5, -3])
def test_camera_paths_beyond_numbers(width: float) -> None:
    content = {"render_width": width, "render_height": 9, "camera_path": [{}]}
    with pytest.raises(InputError, match="render_width") as caught:
        read_camera_path(json.dumps(content).encode())
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize(
    "text",
    [
        "64 64 60 60 32 32" + " 0" * 12,
        "64 64 60 60 32 32" + " 1e300" * 12,
        "64 64 1e300 60 32 32 1 0 0 0 0 1 0 0 0 0 1 0",
        "64 64 60 60 1e300 32 1 0 0 0 0 1 0 0 0 0 1 0",
        "64 64 60 60 32 6465 1 0 0 0 0 1 0 0 0 0 1 0",
        "1e300 64 60 60 32 32 1 0 0 0 0 1 0 0 0 0 1 0",
        "64 200000 60 60 32 32 1 0 0 0 0 1 0 0 0 0 1 0",
        "64 64 60 60 32 32 1 0 0 0 0 1 0 0 0 0 -1 0",
        f"64 64 60 60 32 32 1 0 0 {2 * FARTHEST} 0 1 0 0 0 0 1 0",
        "64 64 60 60 32 32 1 0 0 nan 0 1 0 0 0 0 1 0",
    ],
)
def test_cameras_in_scenes_that_no_view_has(text: str) -> None:
    """They are other programs' comments: the scene is as good without them."""
    assert cameras_from_metadata({"camera.0": text}) == []


def test_cameras_in_scenes_survive_their_rounding() -> None:
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    extrinsics = np.eye(4)
    extrinsics[:3, :3], extrinsics[:3, 3] = turn * np.linalg.det(turn), [1e6, -3, 1e-7]
    (camera,) = cameras_from_metadata(
        cameras_to_metadata([Camera(extrinsics, 60, 61, 32, 31, 64, 48)])
    )
    np.testing.assert_allclose(camera.extrinsics, extrinsics, rtol=1e-7)


def test_text_in_scenes_does_not_reach_the_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Sequences that command a terminal, and what is no text, are shown as such."""
    write_scene(tmp_path / "a.ply", one_gaussian(), {"note": "\x1b]0;owned\x07 \ud800 \r\n"})
    assert main.run(["info", str(tmp_path / "a.ply"), "--no-sizes"]) == 0
    out = capsys.readouterr().out
    assert r"note        \x1b]0;owned\x07 \ud800 \r\n" in out
    assert "\x1b" not in out
    for suffix in (".glb", ".sog", ".compressed.ply"):
        assert main.run(["convert", str(tmp_path / "a.ply"), str(tmp_path / f"b{suffix}")]) == 0


def test_a_hundred_megapixels_in_a_few_kilobytes(run: Run, photos: list[Path]) -> None:
    """A decompression bomb is left out before it takes memory; other photos go on."""
    bomb = photos[0].with_name("bomb.png")
    Image.new("1", (20_000, 10_000)).save(bomb, compress_level=9)
    assert bomb.stat().st_size < 100_000
    scene = photos[0].with_name("x.ply")
    code, _, err = run("reconstruct", *photos[:2], bomb, "-o", scene, "--fov", "50")
    assert code == 0
    assert "left out: " in err
    assert "bomb.png: 200 megapixels in" in err


@pytest.mark.slow
def test_an_honest_photo_of_a_hundred_megapixels(tmp_path: Path) -> None:
    """It is read, in 5 bytes a pixel; a grey picture, so that the file is small to make."""
    resource = pytest.importorskip("resource")
    path = tmp_path / "a.pgm"
    path.write_bytes(b"P5 10000 10000 255\n")
    os.truncate(path, path.stat().st_size + 10**8)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert decode(path).image.size == (10_000, 10_000)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 700_000  # kB
