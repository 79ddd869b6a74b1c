"""`styl3r render`: scenes and cameras in, videos and numbered pictures out."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from two_cameras import BLACK, CAMERAS, Run, camera_at, video_frames

from styl3r_cli.cameras.framing import cropped
from styl3r_cli.cameras.stored import cameras_to_metadata
from styl3r_cli.formats import write_scene
from styl3r_cli.frames import enlarged, to_picture
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.splatting import render
from styl3r_cli.surroundings import fill_holes


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
