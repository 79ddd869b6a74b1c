"""`styl3r render`: scenes and cameras in, videos and numbered pictures out."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from styl3r_cli import main
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.framing import cropped, uncropped
from styl3r_cli.cameras.stored import cameras_from_metadata, cameras_to_metadata
from styl3r_cli.cameras.transforms import write_transforms
from styl3r_cli.commands.render_request import parse_colour
from styl3r_cli.errors import UsageError
from styl3r_cli.formats import write_scene
from styl3r_cli.frames import enlarged, to_picture
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.photos.resize import fit_intrinsics
from styl3r_cli.splatting import render
from styl3r_cli.surroundings import fill_holes

Run = Callable[..., tuple[int, str]]


# What is seen behind a scene in other viewers, and what `render` gives.
BLACK = ("--background", "black")


def camera_at(x: float, width: int = 64, height: int = 48) -> Camera:
    extrinsics = np.eye(4)
    extrinsics[0, 3] = -x
    return Camera(extrinsics, 60.0, 61.0, width / 2 + 1, height / 2 - 2, width, height)


CAMERAS = [camera_at(0.0), camera_at(0.3)]


@pytest.fixture(scope="module")
def gaussians() -> Gaussians:
    rng = np.random.default_rng(5)
    means = rng.uniform([-1, -1, 2], [1, 1, 3], (300, 3))
    return Gaussians(
        means=means,
        scales=rng.uniform(0.03, 0.1, (300, 3)),
        rotations=np.tile([1.0, 0, 0, 0], (300, 1)),
        opacities=rng.uniform(0.5, 1, 300),
        colours=rng.uniform(0, 1, (300, 3)),
    )


@pytest.fixture
def scene(gaussians: Gaussians, tmp_path: Path) -> Path:
    write_scene(tmp_path / "scene.ply", gaussians, cameras_to_metadata(CAMERAS))
    return tmp_path / "scene.ply"


@pytest.fixture
def cameras(tmp_path: Path) -> Path:
    write_transforms(tmp_path / "transforms.json", CAMERAS, ["a.jpg", "b.jpg"])
    return tmp_path / "transforms.json"


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    def run_command(*arguments: object) -> tuple[int, str]:
        code = main.run(["render", "--threads", "1", *map(str, arguments)])
        out, err = capsys.readouterr()
        assert out == ""
        return code, err

    return run_command


def video_frames(path: Path) -> list[np.ndarray]:
    import av

    with av.open(str(path)) as container:
        assert container.streams.video[0].codec_context.name == "h264"
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def test_each_camera_of_a_file_is_one_picture(
    run: Run, scene: Path, cameras: Path, gaussians: Gaussians, tmp_path: Path
) -> None:
    pattern = tmp_path / "out" / "view_%03d.png"
    assert run(scene, "--cameras", cameras, *BLACK, "-o", pattern) == (0, "")
    assert sorted(p.name for p in pattern.parent.iterdir()) == ["view_000.png", "view_001.png"]
    for index, camera in enumerate(CAMERAS):
        picture = np.asarray(Image.open(tmp_path / "out" / f"view_{index:03d}.png"))
        expected = to_picture(render(gaussians, camera).colour)
        assert np.abs(picture.astype(int) - expected).max() <= 1  # the PLY rounds to float32


def test_no_folder_is_made_for_frames_that_never_come(
    run: Run, scene: Path, cameras: Path, tmp_path: Path
) -> None:
    out = tmp_path / "new" / "er" / "%d.png"
    assert run(tmp_path / "no.ply", "-o", out)[0] == 3
    cameras.write_bytes(b"no cameras")
    assert run(scene, "-o", out, "--cameras", cameras)[0] == 3
    code, err = run(scene, "-o", cameras / "new" / "%d.png")
    assert (code, "cannot make the folder" in err) == (6, True)
    assert not (tmp_path / "new").exists()
    path = out.with_name("path.json")
    assert run(scene, "-o", out, "--frames", 1, "--size", 16, "--save-path", path)[0] == 0
    assert sorted(file.name for file in out.parent.iterdir()) == ["0.png", "path.json"]


def test_holes_show_their_surroundings(
    run: Run, scene: Path, cameras: Path, gaussians: Gaussians, tmp_path: Path
) -> None:
    assert run(scene, "--cameras", cameras, "-o", tmp_path / "%d.png") == (0, "")
    picture = np.asarray(Image.open(tmp_path / "1.png")).astype(int)
    frame = render(gaussians, CAMERAS[1])
    assert (frame.alpha < 0.01).any()
    expected = to_picture(fill_holes(frame.colour, frame.alpha))
    assert np.abs(picture - expected).max() <= 1
    assert picture[frame.alpha < 0.01].min() > 0


def test_default_is_a_loop_around_the_stored_views(run: Run, scene: Path, tmp_path: Path) -> None:
    assert run(scene, "--frames", 8, "-o", tmp_path / "v.mp4") == (0, "")
    frames = video_frames(tmp_path / "v.mp4")
    assert len(frames) == 8
    assert frames[0].shape == (384, 512, 3)
    moved = [np.abs(frame.astype(int) - frames[0]).mean() for frame in frames]
    assert moved[4] > moved[1] > 0  # there and back
    assert moved[4] > moved[7]


def test_interpolation_starts_at_the_first_view(
    run: Run, scene: Path, gaussians: Gaussians, tmp_path: Path
) -> None:
    pattern = tmp_path / "%d.png"
    assert run(scene, "--path", "interpolate", "--frames", 2, *BLACK, "-o", pattern) == (0, "")
    for index, camera in enumerate(CAMERAS):
        picture = np.asarray(Image.open(tmp_path / f"{index}.png")).astype(int)
        expected = to_picture(render(gaussians, enlarged(camera, 512)).colour)
        assert np.abs(picture - expected).mean() < 0.5


def test_size_background_and_foreign_scenes(run: Run, gaussians: Gaussians, tmp_path: Path) -> None:
    write_scene(tmp_path / "foreign.ply", gaussians, {})
    target = tmp_path / "a.png"
    options = (
        "--frames",
        1,
        "--size",
        "130x71",
        "--fov",
        120,
        "--background",
        "#00ff00",
        "-o",
        target,
    )
    assert run(tmp_path / "foreign.ply", *options) == (0, "")
    picture = np.asarray(Image.open(target))
    assert picture.shape == (71, 130, 3)
    assert (picture == (0, 255, 0)).all(axis=-1).any()
    assert 0.02 < (picture != (0, 255, 0)).any(axis=-1).mean() < 0.5  # far off, but in view


def test_odd_sizes_and_rates_make_a_video(run: Run, scene: Path, tmp_path: Path) -> None:
    options = ("--frames", 3, "--size", "65x33", "--fps", 29.97, "-o", tmp_path / "v.mp4")
    assert run(scene, *options) == (0, "")
    assert video_frames(tmp_path / "v.mp4")[0].shape == (34, 66, 3)


@pytest.mark.parametrize("path", ["orbit", "spiral", "dolly", "interpolate"])
def test_every_path_makes_a_video_and_a_file_that_makes_it_again(
    run: Run, scene: Path, tmp_path: Path, path: str
) -> None:
    saved, size = tmp_path / "path.json", ("--size", "64x48")
    first = ("--path", path, "--frames", 5, "--fps", 12, "--save-path", saved)
    assert run(scene, *first, *size, "-o", tmp_path / "%d.png") == (0, "")
    assert len(json.loads(saved.read_text())["camera_path"]) == 5
    assert run(scene, "--path", saved, "-o", tmp_path / "again_%d.png") == (0, "")
    for index in range(5):
        assert (tmp_path / f"{index}.png").read_bytes() == (
            tmp_path / f"again_{index}.png"
        ).read_bytes()
    assert run(scene, "--path", saved, "-o", tmp_path / "a.mp4") == (0, "")
    import av

    with av.open(str(tmp_path / "a.mp4")) as container:
        assert container.streams.video[0].average_rate == 12


def test_a_file_of_cameras_becomes_a_path_of_any_length(
    run: Run, scene: Path, cameras: Path, gaussians: Gaussians, tmp_path: Path
) -> None:
    pattern = tmp_path / "%d.png"
    options = ("--path", cameras, "--frames", 9, "--once", "--speed", "constant", "-o", pattern)
    assert run(scene, *options, *BLACK) == (0, "")
    for index, camera in ((0, CAMERAS[0]), (4, camera_at(0.15)), (8, CAMERAS[1])):
        picture = np.asarray(Image.open(tmp_path / f"{index}.png")).astype(int)
        assert np.abs(picture - to_picture(render(gaussians, camera).colour)).mean() < 0.5


def test_fov_is_the_horizontal_angle(
    run: Run, scene: Path, cameras: Path, gaussians: Gaussians, tmp_path: Path
) -> None:
    options = ("--cameras", cameras, "--fov", 90, *BLACK, "-o", tmp_path / "%d.png")
    assert run(scene, *options) == (0, "")
    lens = replace(CAMERAS[1], fx=32.0, fy=32.0, cx=32.0, cy=24.0)
    picture = np.asarray(Image.open(tmp_path / "1.png")).astype(int)
    assert np.abs(picture - to_picture(render(gaussians, lens).colour)).max() <= 1


def test_antialiasing_is_the_renderers(
    run: Run, scene: Path, cameras: Path, gaussians: Gaussians, tmp_path: Path
) -> None:
    options = ("--cameras", cameras, "--size", "16x12", "--antialias", "-o", tmp_path / "%d.png")
    assert run(scene, *options, *BLACK) == (0, "")
    camera = cropped(CAMERAS[1], 16, 12)
    picture = np.asarray(Image.open(tmp_path / "1.png")).astype(int)
    plain, smooth = (to_picture(render(gaussians, camera, antialias=a).colour) for a in (0, 1))
    assert np.abs(picture - smooth).max() <= 1
    assert np.abs(picture - plain).max() > 1


def test_exr_options(run: Run, scene: Path, cameras: Path, tmp_path: Path) -> None:
    import OpenEXR

    options = ("--cameras", cameras, "--exr-parts", "multi", "--exr-compression", "dwaa")
    assert run(scene, *options, "--fps", 25, "-o", tmp_path / "%d.exr") == (0, "")
    file = OpenEXR.File(str(tmp_path / "1.exr"))
    assert [part.name() for part in file.parts] == ["rgba", "depth"]
    assert file.parts[0].header["compression"] == OpenEXR.DWAA_COMPRESSION
    assert file.parts[0].header["framesPerSecond"] == 25
    assert "software: styl3r" in file.parts[0].header["comments"]


def recoloured(gaussians: Gaussians, path: Path) -> Path:
    write_scene(path, gaussians.with_colours(1 - gaussians.colours), cameras_to_metadata(CAMERAS))
    return path


def test_two_scenes_side_by_side(
    run: Run, scene: Path, cameras: Path, gaussians: Gaussians, tmp_path: Path
) -> None:
    other = recoloured(gaussians, tmp_path / "other.ply")
    both = ("--cameras", cameras, "--compare", other, "-o", tmp_path / "%d.png")
    assert run(scene, *both, *BLACK) == (0, "")
    picture = np.asarray(Image.open(tmp_path / "1.png")).astype(int)
    assert picture.shape == (48, 128, 3)
    expected = to_picture(render(gaussians, CAMERAS[1]).colour)
    assert np.abs(picture[:, 64:] - expected).max() <= 1
    assert np.abs(picture[:, :64] - expected).mean() > 20


def test_a_wipe_goes_over_both_scenes(
    run: Run, scene: Path, gaussians: Gaussians, tmp_path: Path
) -> None:
    other = recoloured(gaussians, tmp_path / "other.ply")
    shared = ("--frames", 4, "--size", "64x48")
    assert run(scene, *shared, "-o", tmp_path / "own_%d.png") == (0, "")
    assert run(other, *shared, "-o", tmp_path / "other_%d.png") == (0, "")
    options = ("--compare", other, "--layout", "wipe", "-o", tmp_path / "%d.png")
    assert run(scene, *shared, *options) == (0, "")

    def picture(name: str) -> np.ndarray:
        return np.asarray(Image.open(tmp_path / f"{name}.png"))

    half = picture("0")
    np.testing.assert_array_equal(half[:, :31], picture("other_0")[:, :31])
    np.testing.assert_array_equal(half[:, 33:], picture("own_0")[:, 33:])
    assert (half[:, 31:33] == 255).all()
    np.testing.assert_array_equal(picture("1"), picture("own_1"))
    np.testing.assert_array_equal(picture("3"), picture("other_3"))


def test_depth_has_one_scale_for_the_whole_video(run: Run, tmp_path: Path) -> None:
    """A wall that the camera nears: its colour changes, which a scale per frame would undo."""
    y, x = np.mgrid[-3:3:61j, -3:3:61j]
    ones = np.ones((x.size, 3))
    wall = Gaussians(
        means=np.stack([x.ravel(), y.ravel(), np.full(x.size, 2.0)], axis=1),
        scales=0.1 * ones,
        rotations=np.tile([1.0, 0, 0, 0], (x.size, 1)),
        opacities=ones[:, 0] * 0.99,
        colours=ones,
    )
    write_scene(tmp_path / "wall.ply", wall, cameras_to_metadata([camera_at(0.0)]))
    options = ("--path", "dolly", "--once", "--frames", 3, "--show", "depth", "--size", "64x48")
    grey = ("--colour-map", "grey", "-o", tmp_path / "%d.png")
    assert run(tmp_path / "wall.ply", *options, *grey) == (0, "")
    levels = [np.asarray(Image.open(tmp_path / f"{i}.png"))[24, 32] for i in range(3)]
    assert levels[0].max() < 20
    assert levels[2].min() > 235
    assert levels[0][0] < levels[1][0] < levels[2][0]
    both = ("--show", "both", "--frames", 2, "--size", "64x48", "-o", tmp_path / "a.gif")
    assert run(tmp_path / "wall.ply", *both) == (0, "")
    assert Image.open(tmp_path / "a.gif").size == (128, 48)


def test_transparent_pictures_are_straight_alpha(
    run: Run, scene: Path, cameras: Path, gaussians: Gaussians, tmp_path: Path
) -> None:
    options = ("--cameras", cameras, "--background", "transparent", "-o", tmp_path / "%d.png")
    assert run(scene, *options) == (0, "")
    picture = np.asarray(Image.open(tmp_path / "0.png")).astype(float) / 255
    assert picture.shape == (48, 64, 4)
    colour, alpha = picture[..., :3], picture[..., 3:]
    for level in (0.0, 1.0):
        expected = render(gaussians, CAMERAS[0], (level,) * 3).colour.clip(0, 1)
        seen = alpha[..., 0] > 0.1
        error = np.abs(colour * alpha + level * (1 - alpha) - expected)[seen]
        assert error.max() < 0.02


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
    command = [sys.executable, "-m", "styl3r_cli", "render", str(scene), "--frames", "5000"]
    command += ["--size", "64x48", "-o", target]
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


@pytest.mark.parametrize("name", ["%d", "%d.jpg"])
def test_the_format_that_is_asked_for_is_written_under_any_name(
    run: Run, scene: Path, tmp_path: Path, name: str
) -> None:
    words = ("--frames", 2, "--size", 16, "--background", "transparent", "--format", "png")
    code, error = run(scene, "-o", tmp_path / "png" / name, *words)
    assert code == 0, error
    for path in (tmp_path / "png").iterdir():
        with Image.open(path) as picture:
            assert (picture.format, picture.mode) == ("PNG", "RGBA")
    words = ("--frames", 1, "--size", 16, "--format", "jpg")
    assert run(scene, "-o", tmp_path / "a.png", *words)[0] == 0
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.format == "JPEG"


def test_frames_of_a_longer_film_that_stay_are_told(run: Run, scene: Path, tmp_path: Path) -> None:
    shared = ("--size", 16, "-o", tmp_path / "%02d.png")
    assert run(scene, "--frames", 4, *shared) == (0, "")
    code, err = run(scene, "--frames", 2, *shared)
    assert (code, len(list(tmp_path.glob("*.png")))) == (0, 4)
    assert err == f"styl3r: {tmp_path / '02.png'} is of an earlier film, and stays\n"


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["{scene}", "-o", "x.avi"], 2, "OUT.mp4"),
        (["{scene}", "-o", "x.png", "--frames", "2"], 2, "numbered names"),
        (["{scene}", "-o", "%d_%d.png"], 2, "one frame number"),
        (["{scene}", "-o", "%s%d.png"], 2, "one frame number"),
        (["{scene}", "-o", "x.exr"], 2, "numbered names, such as %04d.exr"),
        (["{scene}", "-o", "x.exr", "--frames", "1", "--background", "red"], 2, "keep their alpha"),
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
