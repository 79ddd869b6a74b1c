"""The gallery: what is drawn where, and how it is written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from PIL import Image
from striped_scene import SIDE, photo, write_scene

from styl3r_export.evaluate.gallery import Plan, Style, draw_scene, main
from styl3r_export.evaluate.groups import choose_groups
from styl3r_export.evaluate.predict import load_stylizer
from styl3r_export.evaluate.scenes import load_scene

MakePicture = Callable[..., Path]


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("scenes")
    for name in ("hall", "box_shelf", "garden"):
        write_scene(root / name, photos=3)
    return root


@pytest.fixture
def styles(tmp_path: Path, make_picture: MakePicture) -> Path:
    folder = tmp_path / "styles"
    folder.mkdir()
    for k in range(11):
        make_picture(folder / f"{k:02d}.png", seed=k)
    return folder


def run(model: Path, scenes: Path, styles: Path, output: Path, *options: str) -> Result:
    command = [
        model,
        "--scenes",
        scenes,
        "--styles",
        styles,
        "-o",
        output,
        "--size",
        SIDE,
        *options,
    ]
    return CliRunner().invoke(main, [str(part) for part in command])


def test_rows_show_the_photo_the_painting_and_the_scene(scenes: Path, tiny_model: Path) -> None:
    red = np.zeros((3, 256, 256), np.float32)
    red[0] = 1
    plan = Plan([], [Style("red", red), Style("black", red * 0)], 2, SIDE, "true", 1)
    (group,) = choose_groups(load_scene(scenes / "hall", SIDE), 2, 1)
    rows = draw_scene(load_stylizer(tiny_model, 1), group, plan)
    assert [row.heading for row in rows] == ["hall, in red", "hall, in black"]
    given, style, stylized, new, own, depth = (cell.picture for cell in rows[0].cells)
    assert all(picture.shape == (SIDE, SIDE, 3) for picture in (given, style, new, own, depth))
    np.testing.assert_array_equal(given, photo().astype(np.uint8))
    assert (style == [255, 0, 0]).all()
    inner = np.s_[8:-8, 8:-8]
    # The tiny model's scene in its own colours is grey, and its red is redder than its black.
    assert np.ptp(own[inner].astype(int), axis=-1).max() <= 2
    black = rows[1].cells[2].picture
    assert stylized[inner][..., 0].mean() > black[inner][..., 0].mean() + 20
    # Stripes are the same from everywhere beside: the new view shows what the first one does.
    assert np.abs(new[inner].astype(int) - stylized[inner]).mean() < 6
    brightness, nearness = own[inner].mean(axis=(1, 2)), depth[inner].astype(int)
    dark, bright = brightness.argmin(), brightness.argmax()
    # What is dark is near (red), what is bright is far (blue).
    assert nearness[dark, :, 0].mean() > nearness[dark, :, 2].mean()
    assert nearness[bright, :, 2].mean() > nearness[bright, :, 0].mean()


def test_one_sheet_or_one_for_each_scene(
    scenes: Path, styles: Path, tiny_model: Path, tmp_path: Path
) -> None:
    result = run(tiny_model, scenes, styles, tmp_path / "all.png")
    assert result.exit_code == 0, result.output
    result = run(tiny_model, scenes, styles, tmp_path / "sheets", "--style-count", "1")
    assert result.exit_code == 0, result.output
    # box_shelf may be trained on, so it is no validation scene.
    assert sorted(p.name for p in (tmp_path / "sheets").iterdir()) == ["garden.png", "hall.png"]
    with Image.open(tmp_path / "all.png") as sheet, Image.open(tmp_path / "sheets/hall.png") as one:
        assert sheet.width == one.width > 6 * SIDE
        # 2 scenes in 2 styles (00 and 10) are three rows more than one in one.
        assert sheet.height - one.height > 3 * SIDE


def test_mistakes_get_one_line(
    scenes: Path, styles: Path, tiny_model: Path, tmp_path: Path
) -> None:
    for options, code in (
        (("--only", "atlantis"), 2),
        (("--views", "8"), 3),
        (("--views", "1"), 2),
    ):
        result = run(tiny_model, scenes, styles, tmp_path / "all.png", *options)
        assert result.exit_code == code, result.output
        assert "Error" in result.stderr
        assert "Traceback" not in result.stderr
    assert not (tmp_path / "all.png").exists()
