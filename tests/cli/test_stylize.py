"""`styl3r stylize`, from files to files: what it writes, tells and refuses."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image
from tiny_model import BASELINE

from styl3r_cli.cameras.stored import cameras_from_metadata
from styl3r_cli.cameras.transforms import read_transforms
from styl3r_cli.commands import scene
from styl3r_cli.formats import read_scene
from styl3r_cli.splatting import render

Run = Callable[..., tuple[int, bytes, str]]


def test_photos_and_a_style_become_a_scene(
    run: Run, photos: list[Path], style: Path, tmp_path: Path
) -> None:
    target = tmp_path / "scene.ply"
    command = ("stylize", photos[0].parent, "--style", style, "-o", target, "--fov", 60)
    assert run(*command, "--all") == (0, b"", "")
    gaussians = read_scene(target).gaussians
    assert len(gaussians) == 3 * 64 * 64  # the model's own size
    art = np.asarray(Image.open(style).resize((64, 64))).mean(axis=(0, 1)) / 255
    photo = np.asarray(Image.open(photos[0]).resize((77, 64)).crop((6, 0, 70, 64))) / 255
    expected = 0.5 * photo + 0.5 * art
    error = gaussians.colours[: 64 * 64].reshape(64, 64, 3) - expected
    assert np.abs(error).mean() < 0.03


def test_same_input_same_bytes(run: Run, photos: list[Path], style: Path, tmp_path: Path) -> None:
    for name in ("a.ply", "b.ply"):
        assert run("stylize", *photos, "--style", style, "-o", tmp_path / name)[0] == 0
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


def test_json_is_one_object_with_everything(
    run: Run,
    photos: list[Path],
    style: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(scene, "LOOP_FRAMES", 6)
    names = {
        "scene": tmp_path / "s.ply",
        "video": tmp_path / "v.mp4",
        "preview": tmp_path / "p.png",
        "cameras": tmp_path / "c.json",
    }
    code, out, err = run(
        *("stylize", *photos, "--style", f"{style}=2", "--strength", 0.5, "-o", names["scene"]),
        *("--video", names["video"], "--preview", names["preview"]),
        *("--cameras-out", names["cameras"], "--json"),
    )
    assert code == 0
    report = json.loads(out)
    assert report["outputs"] == {name: str(path) for name, path in names.items()}
    for path in names.values():
        assert path.stat().st_size > 0
    with av.open(str(names["video"])) as video:
        assert len(list(video.decode(video=0))) == 6
    kept = report["compaction"]
    assert kept["gaussians"] == {"before": 3 * 64 * 64, "after": report["gaussians"]}
    assert report["gaussians"] == len(read_scene(names["scene"]).gaussians) < 3 * 64 * 64
    assert kept["kept"] == pytest.approx(report["gaussians"] / (3 * 64 * 64))
    assert kept["mean_db"] >= kept["worst_db"] >= 45
    assert kept["cameras"] == 5  # three views, two between
    assert report["styles"] == [{"path": str(style), "weight": 2.0}]
    assert report["strength"] == 0.5
    assert report["size"] == [64, 64]
    assert report["model"]["name"] == "tiny"
    assert set(report["repairs"].values()) == {0}
    assert [view["path"] for view in report["views"]] == [str(photo) for photo in photos]
    stages = {"photos", "model", "structure", "appearance", "cameras", "write", "video", "preview"}
    stages |= {"compact", "total"}
    assert set(report["timings"]) == stages
    assert len(report["warnings"]) == len(err.splitlines())
    assert "28 mm equivalent assumed" in err


def test_cameras_are_those_of_the_photos(
    run: Run, photos: list[Path], style: Path, tmp_path: Path
) -> None:
    """The tiny model's views stand BASELINE apart, whatever the field of view."""
    out, target = tmp_path / "c.json", tmp_path / "s.ply"
    command = ("stylize", *photos, "--style", style, "--fov", 50, "-o", target)
    code, report, _ = run(*command, "--cameras-out", out, "--json")
    assert code == 0
    cameras = read_transforms(out)
    assert cameras.file_paths == [f"photos/{photo.name}" for photo in photos]  # from the file
    focal = 48 / np.tan(np.radians(25))  # photos are 96 pixels wide
    stored = cameras_from_metadata(read_scene(target).metadata)
    views = json.loads(report)["views"]
    for index, camera in enumerate(cameras.cameras):
        assert (camera.width, camera.height) == (96, 80)
        assert camera.fx == pytest.approx(focal, rel=0.01)
        assert camera.extrinsics[:3, 3] == pytest.approx([-BASELINE * index, 0, 0], abs=0.01)
        assert views[index]["camera"]["inlier_ratio"] > 0.99
        assert views[index]["camera"]["fx"] == pytest.approx(camera.fx)
        # In the scene file they are the network's: 64x64, cut from a photo scaled to 77x64.
        assert (stored[index].width, stored[index].height) == (64, 64)
        assert stored[index].fx == pytest.approx(camera.fx * 77 / 96, rel=1e-6)
        assert stored[index].extrinsics == pytest.approx(camera.extrinsics, abs=1e-6)


def test_written_cameras_can_be_given_back(
    run: Run, photos: list[Path], style: Path, tmp_path: Path
) -> None:
    first, second = tmp_path / "a.ply", tmp_path / "b.ply"
    file = tmp_path / "c.json"
    command = ("stylize", *photos, "--style", style)
    assert run(*command, "--fov", 50, "-o", first, "--cameras-out", file)[0] == 0
    code, out, err = run(*command, "--cameras", file, "-o", second, "--json")
    assert (code, err) == (0, "")
    assert {view["focal_source"] for view in json.loads(out)["views"]} == {"cameras"}
    a, b = read_scene(first).gaussians, read_scene(second).gaussians
    np.testing.assert_allclose(a.means, b.means, atol=0.01)


def test_strength_and_weights_reach_the_colours(
    run: Run, photos: list[Path], tmp_path: Path
) -> None:
    for name, colour in (("red", (255, 0, 0)), ("blue", (0, 0, 255))):
        Image.new("RGB", (40, 40), colour).save(tmp_path / f"{name}.png")
    red, blue = tmp_path / "red.png", tmp_path / "blue.png"

    def mean_colour(*options: object) -> np.ndarray:
        assert run("stylize", *photos, *options, "--all", "-o", tmp_path / "s.ply")[0] == 0
        return read_scene(tmp_path / "s.ply").gaussians.colours.mean(axis=0)

    full, other = mean_colour("--style", red), mean_colour("--style", blue)
    own = mean_colour("--style", red, "--strength", 0)
    blended = mean_colour("--style", f"{red}=3", "--style", f"{blue}=1")
    np.testing.assert_allclose(blended, 0.75 * full + 0.25 * other, atol=1e-5)
    half = mean_colour("--style", red, "--strength", 0.5)
    np.testing.assert_allclose(half, 0.5 * full + 0.5 * own, atol=1e-5)


def test_an_equals_sign_may_be_part_of_a_style_name(
    run: Run, photos: list[Path], style: Path, tmp_path: Path
) -> None:
    for name in ("a=b.jpg", "c.jpg=7"):
        picture = shutil.copy(style, tmp_path / name)
        code, out, _ = run("stylize", *photos, "-s", picture, "-o", tmp_path / "s.ply", "--json")
        assert code == 0
        assert json.loads(out)["styles"] == [{"path": str(picture), "weight": 1.0}]
    picture = tmp_path / "a=b.jpg"
    code, out, _ = run("stylize", *photos, "-s", f"{picture}=.5", "-o", tmp_path / "s", "--json")
    assert code == 2  # the scene has no suffix
    code, out, _ = run(
        "stylize", *photos, "-s", f"{picture}=.5", "-o", tmp_path / "s.ply", "--json"
    )
    assert json.loads(out)["styles"] == [{"path": str(picture), "weight": 0.5}]


def test_scene_to_standard_output_is_the_same_file(
    run: Run, photos: list[Path], style: Path, tmp_path: Path
) -> None:
    assert run("stylize", *photos, "--style", style, "-o", tmp_path / "s.ply")[0] == 0
    code, out, _ = run("stylize", *photos, "--style", style, "-o", "-")
    assert code == 0
    assert out == (tmp_path / "s.ply").read_bytes()
    assert len(out[: out.index(b"end_header")]) < 4096  # some viewers look no further than 10 KB


def test_size(run: Run, photos: list[Path], style: Path, tmp_path: Path) -> None:
    command = ("stylize", *photos, "--style", style, "-o", tmp_path / "s.ply", "--json", "--size")
    assert json.loads(run(*command, "80x48", "--all")[1])["gaussians"] == 3 * 80 * 48
    assert json.loads(run(*command, "32")[1])["size"] == [32, 32]
    code, _, err = run(*command, "100x48")
    assert code == 2
    assert "multiples of 16" in err


def test_quiet_is_silent_on_success_only(
    run: Run, photos: list[Path], style: Path, tmp_path: Path
) -> None:
    command = ("stylize", *photos, "--style", style, "--quiet", "-o")
    assert run(*command, tmp_path / "s.ply") == (0, b"", "")
    assert run(*command, tmp_path / "no" / "s.ply")[2].startswith("styl3r: error: ")


def test_nine_photos_are_eight_with_a_note(
    run: Run, make_picture: Callable[..., Path], style: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "nine"
    folder.mkdir()
    for index in range(9):
        make_picture(folder / f"{index}.png", seed=index)
    code, out, err = run("stylize", folder, "-s", style, "-o", tmp_path / "s.ply", "--json")
    assert code == 0
    views = [Path(view["path"]).name for view in json.loads(out)["views"]]
    assert len(views) == 8
    assert f"9 photos, of which 8 are used: {', '.join(views)}" in err


def test_a_style_among_the_photos_is_no_photo(
    run: Run, photos: list[Path], style: Path, tmp_path: Path
) -> None:
    art = shutil.copy(style, photos[0].parent / "art.jpg")
    command = ("-s", art, "-o", tmp_path / "s.ply", "--json")
    code, out, err = run("stylize", photos[0].parent, *command)
    assert (code, len(json.loads(out)["views"])) == (0, 3)
    assert "art.jpg is a style" in err
    code, out, _ = run("stylize", *photos, art, *command)  # named as both
    assert (code, len(json.loads(out)["views"])) == (0, 4)


def test_a_scene_is_what_it_requires_unless_all_is_asked_for(
    run: Run, photos: list[Path], style: Path, tmp_path: Path
) -> None:
    """Drawn from the views, and measured as the report says; coarser and dearer on demand."""
    kept: dict[str, dict] = {}
    scenes = {}
    for name, options in {
        "all": ("--all",),
        "default": (),
        "coarse": ("--keep-db", 30),
        "balanced": ("--quality", "balanced"),
        "balanced, small": ("--quality", "balanced", "--keep-db", 45),
    }.items():
        target = tmp_path / f"{name}.ply"
        command = ("stylize", *photos, "--style", style, "--json", "-o", target)
        code, out, err = run(*command, *options)
        assert code == 0, err
        kept[name] = json.loads(out)["compaction"]
        scenes[name] = read_scene(target)
    assert kept["all"] is kept["balanced"] is None
    whole, count = scenes["all"].gaussians, 3 * 64 * 64
    assert len(whole) == len(scenes["balanced"].gaussians) == count
    assert len(scenes["coarse"].gaussians) < len(scenes["default"].gaussians) < count
    assert len(scenes["balanced, small"].gaussians) < count
    for name, promised in (("default", 45), ("coarse", 30)):
        worst = []
        for camera in cameras_from_metadata(scenes[name].metadata):
            squares = [
                (
                    render(whole, camera, (v, v, v)).colour
                    - render(scenes[name].gaussians, camera, (v, v, v)).colour
                )
                ** 2
                for v in (0.0, 1.0)
            ]
            worst.append(-10 * np.log10(np.mean(squares)))
        assert min(worst) >= promised - 0.2  # the file keeps 8 bits fewer of some numbers
        assert kept[name]["worst_db"] >= promised


def test_all_and_a_promise_exclude_each_other(
    run: Run, photos: list[Path], style: Path, tmp_path: Path
) -> None:
    command = ("stylize", *photos, "--style", style, "-o", tmp_path / "s.ply")
    code, _, err = run(*command, "--all", "--keep-db", 40)
    assert code == 2
    assert "--keep-db and --all" in err
