"""The contact sheet: everything is on it, in its place and in the right colours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.contact_sheet import Cell, Row, draw_sheet
from styl3r_cli.depth_colours import EMPTY, colour_depths
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.preview import Preview, write_preview

GREEN = (0, 128, 0)


def flat(colour: tuple[int, int, int], size: tuple[int, int] = (40, 30)) -> np.ndarray:
    return np.full((size[1], size[0], 3), colour, np.uint8)


def wall(colour: tuple[float, float, float]) -> Gaussians:
    """A wall of Gaussians that fills every view, two units ahead."""
    y, x = np.mgrid[-2:2:41j, -2:2:41j]
    count = x.size
    return Gaussians(
        means=np.stack([x.ravel(), y.ravel(), np.full(count, 2.0)], axis=1),
        scales=np.full((count, 3), 0.1),
        rotations=np.tile([1.0, 0, 0, 0], (count, 1)),
        opacities=np.full(count, 0.95),
        colours=np.tile(colour, (count, 1)),
    )


def camera(x: float) -> Camera:
    extrinsics = np.eye(4)
    extrinsics[0, 3] = -x
    return Camera(extrinsics, 64, 64, 32, 32, 64, 64)


def preview(styles: int) -> Preview:
    return Preview(
        images=np.broadcast_to(np.array([0, 0, 1], np.float32)[:, None, None], (2, 3, 64, 64)),
        names=["left.jpg", "right.jpg"],
        styles=[np.full((3, 32, 32), level, np.float32) for level in np.linspace(0.2, 1, styles)],
        style_names=["art.jpg"] * styles,
        result=wall((1, 0, 0)),
        own=wall((0, 1, 0)),
        cameras=[camera(0.0), camera(0.2)],
    )


def count_colour(sheet: np.ndarray, colour: tuple[int, int, int], tolerance: int = 3) -> int:
    return int((np.abs(sheet.astype(int) - colour).max(axis=-1) <= tolerance).sum())


def test_sheet_has_every_picture(tmp_path: Path) -> None:
    write_preview(tmp_path / "sheet.png", preview(styles=1), "title", threads=1)
    sheet = np.asarray(Image.open(tmp_path / "sheet.png"))
    cell = 256 * 256
    assert count_colour(sheet, (0, 0, 255)) == 2 * cell  # photos, enlarged
    assert count_colour(sheet, (51, 51, 51)) >= cell  # the style
    # Two views and the one between, of the result and of its own colours.
    assert count_colour(sheet, (255, 0, 0)) == pytest.approx(3 * cell, rel=0.01)
    assert count_colour(sheet, (0, 255, 0)) == pytest.approx(3 * cell, rel=0.01)
    assert list(tmp_path.iterdir()) == [tmp_path / "sheet.png"]


def test_reconstruction_has_no_style_and_no_second_colours(tmp_path: Path) -> None:
    write_preview(tmp_path / "sheet.png", preview(styles=0), "title", threads=1)
    sheet = np.asarray(Image.open(tmp_path / "sheet.png"))
    assert count_colour(sheet, (0, 0, 255)) == 2 * 256 * 256
    assert count_colour(sheet, (255, 0, 0)) == pytest.approx(3 * 256 * 256, rel=0.01)
    assert count_colour(sheet, (0, 255, 0)) == 0


def test_several_styles_share_one_cell(tmp_path: Path) -> None:
    write_preview(tmp_path / "one.png", preview(styles=1), "title", threads=1)
    write_preview(tmp_path / "two.png", preview(styles=2), "title", threads=1)
    one, two = (np.asarray(Image.open(tmp_path / f"{name}.png")) for name in ("one", "two"))
    assert one.shape == two.shape
    half = 256 * 128
    assert count_colour(two, (51, 51, 51)) == count_colour(one, (51, 51, 51)) - half


def test_depth_colours_have_one_scale_red_near_blue_far() -> None:
    near, far = np.full((8, 8), 1.0, np.float32), np.full((8, 8), 4.0, np.float32)
    solid = np.ones((8, 8), bool)
    holes = solid.copy()
    holes[0] = False
    first, second = colour_depths([near, far], [solid, holes])
    red, _, blue = first[4, 4].astype(int)
    assert red > blue + 50
    red, _, blue = second[4, 4].astype(int)
    assert blue > red
    assert (second[0] == EMPTY).all()


@pytest.mark.parametrize("unit", [2.0**100, 2.0**45, 2.0**-100, 2.0**-130])
def test_depth_colours_are_the_same_in_any_unit(unit: float) -> None:
    depth = np.linspace(1, 4, 64, dtype=np.float32).reshape(8, 8)
    solid = np.ones((8, 8), bool)
    (expected,) = colour_depths([depth], [solid])
    (picture,) = colour_depths([depth * np.float32(unit)], [solid])
    assert np.abs(picture.astype(int) - expected).max() <= 2  # float32 gets coarse from 2^-126 on


@pytest.mark.parametrize("value", [0.0, 3.0])
def test_depth_without_any_variation_or_surface_is_still_a_picture(value: float) -> None:
    depth = np.full((4, 4), value, np.float32)
    (picture,) = colour_depths([depth], [depth > 0])
    assert (picture == picture[0, 0]).all()


def test_cells_are_placed_whole_and_long_captions_are_cut() -> None:
    long = Row("heading", [Cell(flat(GREEN), "a very long caption " * 20), Cell(flat(GREEN), "b")])
    short = Row("heading", [Cell(flat(GREEN), "a"), Cell(flat(GREEN), "b")])
    pages = [np.asarray(draw_sheet("title", [row])) for row in (long, short)]
    assert pages[0].shape == pages[1].shape
    for page in pages:
        green = (page == GREEN).all(axis=-1)
        assert green.sum() == 2 * 40 * 30
    differs = (pages[0] != pages[1]).any(axis=(0, 2)).nonzero()[0]
    second = (pages[1] == GREEN).all(axis=-1).any(axis=0).nonzero()[0][40]
    assert differs.max() < second  # the caption ends before the second cell
