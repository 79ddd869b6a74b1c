"""`styl3r render`: what it refuses, and what it says of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from two_cameras import CAMERAS, Run, camera_at

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.framing import cropped, uncropped
from styl3r_cli.cameras.stored import cameras_from_metadata, cameras_to_metadata
from styl3r_cli.cameras.transforms import write_transforms
from styl3r_cli.commands.render_request import parse_colour
from styl3r_cli.errors import UsageError
from styl3r_cli.formats import read_scene, write_scene
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.photos.resize import fit_intrinsics


def test_frames_of_a_longer_film_that_stay_are_told(run: Run, scene: Path, tmp_path: Path) -> None:
    shared = ("--size", 16, "-o", tmp_path / "%02d.png")
    assert run(scene, "--frames", 4, *shared) == (0, "")
    code, err = run(scene, "--frames", 2, *shared)
    assert (code, len(list(tmp_path.glob("*.png")))) == (0, 4)
    assert err == f"styl3r: {tmp_path / '02.png'} is of an earlier film, and stays\n"


def test_cameras_of_another_shape_are_cropped_and_told(
    run: Run, scene: Path, tmp_path: Path
) -> None:
    wide, tall = CAMERAS[0], cropped(CAMERAS[1], CAMERAS[1].width // 2, CAMERAS[1].height)
    write_transforms(tmp_path / "both.json", [wide, tall], ["a.png", "b.png"])
    alike = cropped(tall, wide.width, wide.height)
    write_transforms(tmp_path / "alike.json", [wide, alike], ["a.png", "b.png"])
    errors = []
    for name in ("both", "alike"):
        code, err = run(
            scene, "--cameras", tmp_path / f"{name}.json", "-o", tmp_path / f"{name}%d.png"
        )
        assert code == 0
        errors.append(err)
        assert len(list(tmp_path.glob(f"{name}?.png"))) == 2
    size = f"{wide.width}x{wide.height}"
    words = f"both.json: cameras of another shape are cropped to {size}"
    assert [words in err for err in errors] == [True, False]
    pictures = [(tmp_path / f"{name}1.png").read_bytes() for name in ("both", "alike")]
    assert pictures[0] == pictures[1]


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["{scene}", "-o", "x.avi"], 2, "OUT.mp4"),
        (["{scene}", "-o", "x.png", "--frames", "2"], 2, "numbered names"),
        (["{scene}", "-o", "%d_%d.png"], 2, "one frame number"),
        (["{scene}", "-o", "%s%d.png"], 2, "one frame number"),
        (["{scene}", "-o", "x.exr"], 2, "numbered names, such as %04d.exr"),
        (["{scene}", "-o", "x.exr", "--frames", "1", "--background", "red"], 2, "keep their alpha"),
        (["{scene}", "-o", "x.mp4", "--format", "gif"], 2, "x.mp4 and --format gif contradict"),
        (["{scene}", "-o", "%d.PNG", "--format", "jpg"], 2, "contradict"),
        (["{scene}", "-o", "no/x.mp4"], 6, "does not exist"),
        (["{scene}", "-o", "-", "--format", "exr"], 2, "need files"),
        (["{scene}", "-o", "x.exr", "--show", "depth"], 2, "one scene"),
        (["{scene}", "-o", "x.mp4", "--background", "transparent"], 2, "no alpha"),
        (["{scene}", "-o", "x.mp4", "--path", "moonwalk"], 2, "no such path"),
        (["{scene}", "-o", "x.mp4", "--path", "moon.json"], 3, "moon.json"),
        (["{scene}", "-o", "x.mp4", "--arc", "90"], 2, "orbit"),
        (["{scene}", "-o", "x.mp4", "--layout", "side"], 2, "--layout is for --compare"),
        (["{scene}", "-o", "x.mp4", "--colour-map", "turbo"], 2, "--colour-map is for --show"),
        (["{scene}", "-o", "x.mp4", "--exr-compression", "zip"], 2, "is for EXR frames"),
        (["{scene}", "-o", "%d.png", "--exr-parts", "multi"], 2, "is for EXR frames"),
        (["{scene}", "-o", "x.mp4", "--cameras", "{cameras}", "--amplitude", "1"], 2, "--path"),
        (["{scene}", "-o", "x.mp4", "--cameras", "{cameras}", "--once"], 2, "--path"),
        (["{scene}", "-o", "x.mp4", "--path", "{cameras}", "--speed", "eased"], 2, "--frames"),
        (["{scene}", "-o", "x.mp4", "--compare", "no.ply"], 3, "no.ply"),
        (["-", "-o", "x.mp4", "--compare", "-"], 2, "standard input is one scene"),
        (["{scene}", "-o", "x.mp4", "--compare", "{scene}", "--show", "both"], 2, "no room"),
        (["{scene}", "-o", "x.gif", "--fps", "60", "--frames", "2"], 2, "at most 50"),
        (["{scene}", "-o", "x.gif", "--fps", "1e-9", "--frames", "2"], 2, "0.01 or more"),
        (["{scene}", "-o", "%d.png", "--fps", "nan"], 2, "not a finite number"),
        (["{scene}", "-o", "x.mp4", "--path", "orbit", "--arc", "nan"], 2, "not a finite number"),
        (["{scene}", "-o", "x.mp4", "--frames", "9" * 30], 2, "--frames"),
        (["{scene}", "-o", "x.gif", "--size", "70000x2"], 2, "at most 65535 a side"),
        (["{scene}", "-o", "%d.jpg", "--size", "2x70000"], 2, "at most 65500 a side"),
        (["{scene}", "-o", "x.webp", "--size", "8192", "--show", "both"], 2, "at most 16383"),
        (["{scene}", "-o", ""], 2, "name is empty"),
        (["{scene}", "-o", "%0999999999d.png"], 2, "one frame number"),
        (["{scene}", "-o", "%+.2147483646d%d.png"], 2, "one frame number"),
        (["{scene}", "-o", "x.mp4", "--fps", "1e-9", "--save-path", "p.json"], 2, "0.01 or more"),
        (["{scene}", "-o", "%d.png", "--fps", "1e-308", "--save-path", "p.json"], 2, "0.01 or"),
        (
            ["{scene}", "-o", "x.mp4", "--save-path", "{cameras}", "--cameras", "{cameras}"],
            2,
            "input",
        ),
        (["{scene}", "-o", "x.mp4", "--background", "greenish"], 2, "greenish"),
        (["{scene}", "-o", "x.mp4", "--background", "rgba(1,2,3,9)"], 2, "rgba(1,2,3,9)"),
        (["{scene}", "-o", "x.mp4", "--background", ""], 2, "not a colour"),
        (["{scene}", "-o", "x.mp4", "--background", "rgb(300,0,0)"], 2, "rgb(300,0,0)"),
        (["{scene}", "-o", "x.mp4", "--background", "hsl(0,200%,50%)"], 2, "not a colour"),
        (["{scene}", "-o", "x.mp4", "--cameras", "{cameras}", "--frames", "3"], 2, "--path"),
        (["{scene}", "-o", "x.mp4", "--cameras", "no.json"], 3, "no.json"),
        (["{foreign}", "-o", "x.mp4", "--path", "interpolate"], 2, "interpolate"),
        (["{cameras}", "-o", "x.mp4"], 2, "unknown scene format"),
        (["no.ply", "-o", "x.mp4"], 3, "no.ply"),
    ],
)
def test_mistakes_get_one_line_and_their_code(
    run: Run,
    scene: Path,
    cameras: Path,
    gaussians: Gaussians,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    code: int,
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    foreign = tmp_path / "foreign.ply"
    write_scene(foreign, gaussians, {})
    before = sorted(tmp_path.iterdir())
    names = {"scene": scene, "cameras": cameras, "foreign": foreign}
    status, err = run(*(argument.format(**names) for argument in arguments))
    assert status == code
    assert err.startswith("styl3r: error: ")
    assert err.count("\n") == 1
    assert words in err
    assert sorted(tmp_path.iterdir()) == before


def test_broken_scenes_are_named(run: Run, scene: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.ply"
    cut.write_bytes(scene.read_bytes()[:-10])
    code, err = run(cut, "-o", tmp_path / "v.mp4")
    assert code == 3
    assert "cut.ply: cut off" in err
    assert not (tmp_path / "v.mp4").exists()


def test_colours_have_names_and_numbers() -> None:
    assert parse_colour("white") == (1.0, 1.0, 1.0)
    assert parse_colour("#336699") == pytest.approx((0.2, 0.4, 0.6))
    assert parse_colour("rgb(51,102,153)") == pytest.approx((0.2, 0.4, 0.6))
    with pytest.raises(UsageError, match="not a colour"):
        parse_colour("0.5")


def test_stored_cameras_come_back() -> None:
    rng = np.random.default_rng(1)
    turned = camera_at(0.1)
    turned.extrinsics[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    metadata = cameras_to_metadata([*CAMERAS, turned] * 3)
    assert sum(len(key) + len(value) for key, value in metadata.items()) < 3000
    for before, after in zip([*CAMERAS, turned] * 3, cameras_from_metadata(metadata), strict=True):
        np.testing.assert_allclose(after.extrinsics, before.extrinsics, atol=1e-7)
        np.testing.assert_allclose(after.intrinsics, before.intrinsics, rtol=1e-7)
        assert (after.width, after.height) == (before.width, before.height)


@pytest.mark.parametrize("text", ["", "hello", "1 2 3", " ".join(["nan"] * 18)])
def test_foreign_camera_lines_are_no_cameras(text: str) -> None:
    metadata = cameras_to_metadata(CAMERAS) | {"camera.1": text}
    assert len(cameras_from_metadata(metadata)) == 1


@pytest.mark.parametrize("size", [(640, 475), (475, 640), (301, 4001), (256, 256)])
@pytest.mark.parametrize("frame", [(256, 256), (512, 288)])
def test_uncropped_undoes_the_photos_crop(size: tuple[int, int], frame: tuple[int, int]) -> None:
    camera = Camera(np.eye(4), 700.0, 710.0, size[0] * 0.45, size[1] * 0.55, *size)
    width, height = frame
    fitted = fit_intrinsics(camera.intrinsics, size, (height, width)) * [[width], [height], [1]]
    small = Camera(np.eye(4), fitted[0, 0], fitted[1, 1], fitted[0, 2], fitted[1, 2], width, height)
    whole = uncropped(small, *size)
    np.testing.assert_allclose(whole.intrinsics, camera.intrinsics, rtol=1e-5)
    # `cropped` does not round, so it agrees to half a pixel of the scaled photo.
    np.testing.assert_allclose(cropped(camera, width, height).intrinsics, fitted, rtol=0.01)


def changed(scene: Path, old: bytes, new: bytes) -> Path:
    """The scene with something else in its header."""
    path = scene.with_name("changed.ply")
    data = scene.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new, 1))
    return path


def test_a_format_is_for_names_that_do_not_say_it(run: Run, scene: Path, tmp_path: Path) -> None:
    for name in ("x", "x.unknown", "x.jpeg", "x.JPG"):
        options = ("--format", "jpg", "--frames", 1, "--size", 16)
        assert run(scene, "-o", tmp_path / name, *options) == (0, "")
        assert (tmp_path / name).read_bytes().startswith(b"\xff\xd8")


IGNORED = "styl3r: the scene's cameras are damaged and ignored\n"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b"camera.0: 64 ", b"camera.0: nan ", IGNORED),
        (b"camera.0: 64 ", b"camera.0: 64.5 ", IGNORED),
        (b"camera.0: 64 48 60 ", b"camera.0: 64 48 0 ", IGNORED),
        (b"camera.0: ", b"camera.7: ", IGNORED),
        (b"comment camera.0", b"comment camera.0: another\ncomment camera.0", IGNORED),
        (b"camera.1: ", b"camera.1: nan ", IGNORED.replace(" are", " from camera.1 on are")),
        (b"camera.1: ", b"camera.2: ", IGNORED.replace(" are", " from camera.1 on are")),
        (b"camera.1: ", b"a.camera: ", ""),
    ],
)
def test_damaged_cameras_of_a_scene_are_told(
    run: Run, scene: Path, tmp_path: Path, old: bytes, new: bytes, words: str
) -> None:
    damaged = changed(scene, old, new)
    options = ("-o", tmp_path / "x.png", "--frames", 1, "--size", 16)
    assert run(damaged, *options) == (0, words)
    assert run(damaged, "--compare", damaged, *options) == (0, words)


def test_a_scene_to_compare_with_without_gaussians_is_told(
    run: Run, scene: Path, tmp_path: Path
) -> None:
    empty = tmp_path / "empty.ply"
    none = np.zeros((0, 3), np.float32)
    write_scene(empty, Gaussians(none, none, np.zeros((0, 4), np.float32), none[:, 0], none))
    options = ("-o", tmp_path / "x.png", "--frames", 1, "--size", 16)
    told = f"styl3r: {empty}: no Gaussians in it: nothing is to be seen\n"
    assert run(scene, "--compare", empty, *options) == (0, told)
    assert run(empty, "--compare", scene, *options) == (0, told)


@pytest.mark.parametrize("name", ["x.png", "x.exr"])
def test_frames_without_anything_of_the_scene_are_told(
    run: Run, scene: Path, tmp_path: Path, name: str
) -> None:
    cameras = tmp_path / "away.json"
    ahead = cameras_from_metadata(read_scene(scene).metadata)[0]
    turn = np.diag([-1.0, 1, -1, 1])
    back = replace(ahead, extrinsics=turn @ ahead.extrinsics)
    write_transforms(cameras, [ahead, back], ["a", "b"])
    output = tmp_path / f"%d{name}"
    told = f"styl3r: {scene}: nothing of it is to be seen in 1 of 2 frames\n"
    assert run(scene, "--cameras", cameras, "-o", output, "--size", 16) == (0, told)


@pytest.mark.parametrize("options", [(), ("--show", "depth"), ("--show", "both")])
def test_gaussians_without_any_extent_are_told(
    run: Run, scene: Path, tmp_path: Path, options: tuple[str, ...]
) -> None:
    flat = tmp_path / "flat.ply"
    gaussians = read_scene(scene).gaussians
    write_scene(flat, replace(gaussians, scales=np.zeros_like(gaussians.scales)))
    given = ("-o", tmp_path / "x.png", "--frames", 1, "--size", 16, "--antialias", *options)
    told = f"styl3r: {flat}: nothing of it is to be seen in 1 of 1 frames\n"
    assert run(flat, *given) == (0, told)
