"""Colours fitted to the views: pictures are drawn sharper, and nothing else changes."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.compaction import search
from styl3r_cli.gaussians import FloatArray
from styl3r_cli.painter import Painter, warm_up
from styl3r_cli.picture_metrics import psnr
from styl3r_cli.pipeline import Scene, Stylizer, assemble
from styl3r_cli.splatting import render
from styl3r_cli.surfels import surfels

SIDE, FOCAL, DEPTH, STEP = 32, 32.0, 2.0, 0.25
WIDE = 0.9  # standard deviation of the Gaussians, pixels: drawn pictures are blurred


class Brush:
    """A model whose appearance graph gives what it is told to; counts its runs."""

    def __init__(self, pictures: FloatArray, paints_pictures: bool = True) -> None:
        self.model = SimpleNamespace(paints_pictures=paints_pictures)
        self.pictures = pictures

    def colours(self, *_: Any, **__: Any) -> FloatArray:
        """The pictures."""
        return self.pictures


@pytest.fixture
def scene() -> Scene:
    """Two views of a wall, each with a Gaussian a pixel; the second camera stands to the right."""
    grid = (np.arange(SIDE) + 0.5 - SIDE / 2) / FOCAL * DEPTH
    x, y = np.meshgrid(grid, grid)
    wall = np.stack((x, y, np.full_like(x, DEPTH)), -1)
    means = np.stack((wall, wall + np.array((STEP, 0, 0.01)))).astype(np.float32)
    shape = means.shape[:3]
    return Scene(
        images=np.full((2, 3, SIDE, SIDE), 0.5, np.float32),
        intrinsics=np.tile(np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]], np.float32), (2, 1, 1)),
        means=means,
        scales=np.full((*shape, 3), WIDE * DEPTH / FOCAL, np.float32),
        rotations=np.tile(np.array([1, 0, 0, 0], np.float32), (*shape, 1)),
        opacities=np.full(shape, 0.8, np.float32),
        content_tokens=np.zeros((2, 4, 8), np.float32),
    )


@pytest.fixture
def recovered() -> Recovered:
    second = np.eye(4)
    second[0, 3] = -STEP
    cameras = [
        Camera(pose, FOCAL, FOCAL, SIDE / 2, SIDE / 2, SIDE, SIDE) for pose in (np.eye(4), second)
    ]
    return Recovered(cameras, [1.0, 1.0], [True, True], None, None, [])


@pytest.fixture
def pictures(scene: Scene) -> FloatArray:
    """What both views show of one striped wall: fine strokes in colour."""
    x, y = scene.means[..., 0], scene.means[..., 1]
    waves = [np.sin(18 * x), np.sin(15 * (x + y)), np.sin(20 * y)]
    return (0.5 + 0.35 * np.stack(waves, -1)).astype(np.float32)


def paint(brush: Brush, scene: Scene, recovered: Recovered, fitted: bool = True) -> Painter:
    return Painter(cast(Stylizer, brush), scene, recovered, 1, fitted)


def seen(gaussians: Any, recovered: Recovered) -> list[FloatArray]:
    return [render(gaussians, camera, threads=1).colour for camera in recovered.cameras]


def middle(picture: FloatArray) -> FloatArray:
    """Without the border, where the wall ends."""
    return picture[4:-4, 8:-8]


def test_fitted_colours_show_the_pictures_more_sharply(
    scene: Scene, recovered: Recovered, pictures: FloatArray
) -> None:
    plain, _ = paint(Brush(pictures), scene, recovered, fitted=False)()
    fitted, _ = paint(Brush(pictures), scene, recovered)()
    for before, after, want in zip(
        seen(plain, recovered), seen(fitted, recovered), pictures, strict=True
    ):
        gained = psnr(middle(after), middle(want)) - psnr(middle(before), middle(want))
        assert gained > 5  # decibels
    # From between the views, too, though no picture was given for there.
    pose = np.eye(4)
    pose[0, 3] = -STEP / 2
    between = replace(recovered.cameras[0], extrinsics=pose)
    x = scene.means[0, :, :, 0] + STEP / 2
    y = scene.means[0, :, :, 1]
    want = 0.5 + 0.35 * np.stack([np.sin(18 * x), np.sin(15 * (x + y)), np.sin(20 * y)], -1)
    drawn = [middle(render(each, between, threads=1).colour) for each in (plain, fitted)]
    assert psnr(drawn[1], middle(want)) > psnr(drawn[0], middle(want)) + 3


def test_fitting_changes_only_colours_and_they_stay_in_range(
    scene: Scene, recovered: Recovered, pictures: FloatArray
) -> None:
    plain, _ = paint(Brush(pictures), scene, recovered, fitted=False)()
    fitted, repairs = paint(Brush(pictures), scene, recovered)()
    for name in ("means", "scales", "rotations", "opacities"):
        np.testing.assert_array_equal(getattr(fitted, name), getattr(plain, name))
    assert 0 <= fitted.colours.min() <= fitted.colours.max() <= 1
    assert str(repairs) == ""


def test_what_a_view_shows_of_others_where_its_own_is_invisible_changes_no_colour(
    scene: Scene, recovered: Recovered, pictures: FloatArray
) -> None:
    """Such a view's own depths were not believed: others' Gaussians are not where it has them."""
    opacities = scene.opacities.copy()
    opacities[1] = 0
    scene = replace(scene, opacities=opacities)
    other = pictures.copy()
    other[1] = pictures[1, ::-1]
    one, two = (paint(Brush(each), scene, recovered)()[0] for each in (pictures, other))
    visible = one.opacities > 0
    assert visible.sum() == SIDE * SIDE
    np.testing.assert_array_equal(one.colours[visible], two.colours[visible])


def test_warming_up_loads_what_stylizing_uses_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    used = []

    def noted(name: str, work: Callable[..., Any]) -> Callable[..., Any]:
        def do(*given: Any) -> Any:
            result = work(*given)
            used.append(name)
            return result

        return do

    for name in ("attempt", "reshaped"):
        monkeypatch.setattr(search, name, noted(name, getattr(search, name)))
    warm_up(compact=True)
    for thread in threading.enumerate():
        if thread.name == "warm up":
            thread.join()
    assert set(used) == {"attempt"}


def test_what_both_views_show_is_kept_once(
    scene: Scene, recovered: Recovered, pictures: FloatArray
) -> None:
    whole, _ = assemble(surfels(scene, recovered), pictures)
    kept, repairs = paint(Brush(pictures), scene, recovered, fitted=False)(strength=0.0)
    assert len(kept) < 0.8 * len(whole)
    assert str(repairs) == ""
    for camera in recovered.cameras:
        frames = [render(each, camera, threads=1) for each in (whole, kept)]
        assert psnr(middle(frames[1].colour), middle(frames[0].colour)) > 28
        assert np.abs(frames[1].alpha - frames[0].alpha).max() < 0.02


def test_a_view_in_its_own_strokes_is_not_blurred_by_anothers(
    scene: Scene, recovered: Recovered, pictures: FloatArray
) -> None:
    """The second view's depths are a little off: its strokes lie beside the first's."""
    scene.means[1, ..., 2] *= 1.03
    pictures[1] = np.roll(pictures[1], 2, axis=1)
    styled, own = (paint(Brush(pictures), scene, recovered)(strength=s)[0] for s in (1.0, 0.0))
    want = middle(pictures[0])
    kept = [psnr(middle(seen(each, recovered)[0]), want) for each in (styled, own)]
    assert kept[0] > kept[1] + 3


def test_a_second_style_is_fitted_as_if_it_were_the_first(
    scene: Scene, recovered: Recovered, pictures: FloatArray
) -> None:
    brush = Brush(pictures)
    painter = paint(brush, scene, recovered)
    painter()
    brush.pictures = 1 - pictures[..., ::-1]
    again, _ = painter()
    fresh, _ = paint(Brush(brush.pictures), scene, recovered)()
    np.testing.assert_allclose(again.colours, fresh.colours, atol=1e-6)


def test_colours_of_other_models_are_left_alone(
    scene: Scene, recovered: Recovered, pictures: FloatArray
) -> None:
    plain, _ = assemble(scene, pictures)
    given, _ = paint(Brush(pictures, paints_pictures=False), scene, recovered)()
    np.testing.assert_array_equal(given.colours, plain.colours)


def test_a_view_without_a_camera_has_no_say(
    scene: Scene, recovered: Recovered, pictures: FloatArray
) -> None:
    """Its picture belongs to another place than the one that stands in for its camera."""
    lost = replace(recovered, recovered=[True, False])
    other = pictures.copy()
    other[1] = 0
    ours, theirs = (paint(Brush(each), scene, lost)()[0].colours for each in (pictures, other))
    first = SIDE * SIDE
    sure = np.s_[: first // 2]  # of the first view; its own start is the same in both
    assert np.abs(ours[sure] - theirs[sure]).max() < np.abs(pictures - other).max()
    with_both, _ = paint(Brush(other), scene, recovered)()
    assert (
        np.abs(ours[sure] - theirs[sure]).mean()
        < np.abs(ours[sure] - with_both.colours[sure]).mean()
    )


def test_pictures_that_are_not_finite_are_not_fitted_to(
    scene: Scene, recovered: Recovered, pictures: FloatArray
) -> None:
    pictures[0, 3, 4] = np.nan
    gaussians, repairs = paint(Brush(pictures), scene, recovered)()
    assert repairs.dropped_not_finite == 1
    assert np.isfinite(gaussians.colours).all()


def test_a_style_is_painted_once_and_own_colours_view_by_view(
    scene: Scene, recovered: Recovered, pictures: FloatArray
) -> None:
    wave = 0.3 * np.sin(8 * scene.means[0])
    pictures[0], pictures[1] = 0.5 + wave[..., :1], 0.5 + wave[..., 1:2]  # upright, level
    own, styled = (
        middle(seen(paint(Brush(pictures), scene, recovered)(strength=strength)[0], recovered)[1])
        for strength in (0.0, 1.0)
    )
    shared = np.s_[4:-4, : SIDE // 2 - 2]  # of the second view: what the first sees, too
    # By how much lightness changes from row to row, beside how much from column to column.
    level = [np.ptp(each[shared].mean(axis=1)) for each in (styled, own)]
    upright = [np.ptp(each[shared].mean(axis=0)) for each in (styled, own)]
    assert level[0] < 0.2 * upright[0]
    assert level[1] > 0.5 * upright[1]  # half of what each view says


def test_strokes_without_a_fit_are_sharpened_for_what_drawing_blurs(
    scene: Scene, recovered: Recovered, pictures: FloatArray
) -> None:
    """The contrast of fine stripes in the frames is nearer to the pictures'."""
    plain, _ = assemble(scene, pictures)
    painted, _ = paint(Brush(pictures), scene, recovered, fitted=False)()
    assert 0 <= painted.colours.min() <= painted.colours.max() <= 1
    for before, after, want in zip(
        seen(plain, recovered), seen(painted, recovered), pictures, strict=True
    ):
        missing = [middle(want).std() - middle(frame).std() for frame in (before, after)]
        assert abs(missing[1]) < 0.8 * missing[0]
