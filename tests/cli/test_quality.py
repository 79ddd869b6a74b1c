"""`--quality`: what it changes, and that it keeps what its measured points promise."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from styl3r_cli import main
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.recover import recover
from styl3r_cli.formats import read_scene
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.graphs import find
from styl3r_cli.manifest import read_manifest
from styl3r_cli.painter import Painter
from styl3r_cli.photos import load_photos, load_style
from styl3r_cli.picture_metrics import psnr
from styl3r_cli.pipeline import Stylizer
from styl3r_cli.quality import (
    BEST,
    COMPACTED,
    FITTED,
    KEPT_DECIBELS,
    QUALITIES,
    measured,
    network_size,
)
from styl3r_cli.tradeoff.agreement import compare_pictures, watch, worst
from styl3r_cli.tradeoff.presets import FRAME_SIDES, SIDE

Run = Callable[..., tuple[int, bytes, str]]
ROOT = Path(__file__).parents[2]
needs_points = pytest.mark.skipif(
    not measured(), reason="no measured points; python -m styl3r_cli.tradeoff.presets makes them"
)


def test_sizes_are_shares_of_the_models_own() -> None:
    assert [network_size(quality, (256, 320)) for quality in QUALITIES] == [
        (128, 160),
        (256, 320),
        (256, 320),
    ]
    assert network_size("draft", (16, 16)) == (16, 16)


def test_stylize_reads_photos_at_the_size_of_the_quality(
    run: Run, photos: list[Path], style: Path, tmp_path: Path
) -> None:
    target = tmp_path / "scene.ply"
    for quality, side in (("draft", 32), ("balanced", 64), ("best", 64)):
        command = ("stylize", *photos, "-s", style, "-o", target, "--quality", quality, "--all")
        assert run(*command)[0] == 0
        assert len(read_scene(target).gaussians) == 3 * side * side
        assert run(*command, "--size", 16)[0] == 0
        assert len(read_scene(target).gaussians) == 3 * 16 * 16  # the size asked for wins


def test_render_draws_smaller_and_enlarges(
    run: Run, photos: list[Path], style: Path, tmp_path: Path
) -> None:
    scene = tmp_path / "scene.ply"
    assert run("stylize", *photos, "-s", style, "-o", scene)[0] == 0
    pictures = []
    for quality in QUALITIES:
        path = tmp_path / f"{quality}.png"
        command = ["render", scene, "-o", path, "--frames", 1, "--size", "96x80"]
        assert main.run([*map(str, command), "--quality", quality]) == 0
        pictures.append(np.asarray(Image.open(path)) / 255)
    draft, balanced, best = pictures
    assert draft.shape == balanced.shape == best.shape == (80, 96, 3)
    assert 20 < psnr(draft, best) < psnr(balanced, best) < 100


def test_frames_for_compositors_are_never_drafts(tmp_path: Path) -> None:
    command = ["render", "none.ply", "-o", str(tmp_path / "%d.exr"), "--quality", "draft"]
    assert main.run(command) == 2


@needs_points
@pytest.mark.parametrize("command", ["stylize", "render"])
def test_help_tells_the_measured_points(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    points = measured()[command]
    assert main.run([command, "--help"]) == 0
    told = re.sub(r"\s+", " ", capsys.readouterr().out)
    for quality in ("draft", "balanced"):
        assert re.search(rf"{quality} [\d.]+ m?s, {points[quality]['decibels']} dB", told)
    assert points["draft"]["seconds"] < points["best"]["seconds"]


@needs_points
def test_points_are_those_of_the_bundled_model() -> None:
    """Another model needs other points: `python -m styl3r_cli.tradeoff.presets` measures them."""
    assert measured()["weights_id"] == read_manifest(find("mini")).weights_id


def stylized(stylizer: Stylizer, quality: str, whole: bool) -> tuple[Gaussians, list[Camera]]:
    """The example as `stylize --quality` makes it, with every Gaussian or as many as it keeps."""
    photos = load_photos(
        sorted((ROOT / "examples" / "room").glob("*.jpg")), network_size(quality, (SIDE, SIDE))
    )
    scene = stylizer.encode(photos)
    found = recover(scene.means, scene.opacities, scene.intrinsics, photos.focals_measured)
    painter = Painter(stylizer, scene, found, None, FITTED[quality])
    gaussians, _ = painter([load_style(ROOT / "examples" / "styles" / "night.jpg").image])
    if COMPACTED[quality] and not whole:
        gaussians = painter.compact(gaussians, KEPT_DECIBELS).gaussians
    return gaussians, found.cameras


@needs_points
@pytest.mark.slow
def test_stylize_keeps_its_promises_on_the_example() -> None:
    stylizer = Stylizer("mini", "cpu")
    whole, cameras = stylized(stylizer, BEST, whole=True)
    wanted = watch(whole, cameras, (SIDE, SIDE), None)
    for quality in QUALITIES:
        seen = watch(*stylized(stylizer, quality, whole=False), (SIDE, SIDE), None)
        reached = worst(compare_pictures(seen, wanted, len(cameras)))
        assert reached >= measured()["stylize"][quality]["decibels"], quality


@needs_points
@pytest.mark.slow
@pytest.mark.parametrize("quality", ["draft", "balanced"])
def test_render_keeps_its_promise_on_the_example(quality: str, tmp_path: Path) -> None:
    scene = tmp_path / "scene.ply"
    room, style = ROOT / "examples" / "room", ROOT / "examples" / "styles" / "night.jpg"
    assert main.run(["stylize", str(room), "-s", str(style), "-o", str(scene), "-q"]) == 0
    command = ["render", str(scene), "--frames", "3", "--size", str(FRAME_SIDES["render"]), "-q"]
    pictures = []
    for name in (quality, "best"):
        pattern = tmp_path / name / "%d.png"
        assert main.run([*command, "-o", str(pattern), "--quality", name]) == 0
        files = sorted(pattern.parent.iterdir())
        pictures.append([np.asarray(Image.open(path)) / 255 for path in files])
    agreement = min(psnr(a, b) for a, b in zip(*pictures, strict=True))
    assert agreement >= measured()["render"][quality]["decibels"]
