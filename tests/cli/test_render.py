"""`styl3r render`: scenes and cameras in, videos and numbered pictures out."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
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

Run = Callable[..., tuple[int, str]]


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
    assert run(scene, "--cameras", cameras, "-o", pattern) == (0, "")
    assert sorted(p.name for p in pattern.parent.iterdir()) == ["view_000.png", "view_001.png"]
    for index, camera in enumerate(CAMERAS):
        picture = np.asarray(Image.open(tmp_path / "out" / f"view_{index:03d}.png"))
        expected = to_picture(render(gaussians, camera).colour)
        assert np.abs(picture.astype(int) - expected).max() <= 1  # the PLY rounds to float32


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
    assert run(scene, "--path", "interpolate", "--frames", 2, "-o", pattern) == (0, "")
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


def test_pipes_at_both_ends(scene: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "styl3r_cli", "render", "-", "--frames", "2", "-o", "-"]
    with scene.open("rb") as file:
        result = subprocess.run(command, stdin=file, capture_output=True, check=True)
    assert result.stderr == b""
    (tmp_path / "v.mp4").write_bytes(result.stdout)
    assert len(video_frames(tmp_path / "v.mp4")) == 2


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
        (["{scene}", "-o", "x.mp4", "--background", "greenish"], 2, "greenish"),
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
