"""Pictures to judge a model by: `python -m styl3r_export.evaluate.gallery MODEL ... -o PNG`."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.contact_sheet import Cell, Row, draw_sheet
from styl3r_cli.errors import InputError, Styl3rError, UsageError
from styl3r_cli.files import atomic_write
from styl3r_cli.frames import Drawing, Picture, to_picture
from styl3r_cli.gaussians import FloatArray, Gaussians
from styl3r_cli.painter import Painter
from styl3r_cli.photos.load import STYLE_SIDE, load_style
from styl3r_cli.photos.resize import PATCH, fit_style
from styl3r_cli.pipeline import Stylizer
from styl3r_cli.preview import SOLID, colour_depths
from styl3r_export.evaluate.consistency import camera_path
from styl3r_export.evaluate.groups import Group, choose_groups, pick
from styl3r_export.evaluate.predict import Intrinsics, Prediction, load_stylizer, predict
from styl3r_export.evaluate.scenes import load_scene, scene_folders
from styl3r_export.evaluate.settings import TRAINING_SCENES
from styl3r_export.evaluate.style import held_out_styles

FOLDER = click.Path(exists=True, file_okay=False, path_type=Path)


@dataclass(frozen=True)
class Style:
    """A style picture: its name, and (3, side, side) in [0, 1]."""

    name: str
    image: FloatArray


@dataclass(frozen=True)
class Plan:
    """What a gallery shows; see the command's options."""

    scenes: list[Path]
    styles: list[Style]
    views: int
    size: int
    intrinsics: Intrinsics
    threads: int


@click.command(help="Draw scenes in several styles, with their own colours, depth and a new view.")
@click.argument("model", type=click.Path(path_type=Path))
@click.option("--scenes", type=FOLDER, required=True, help="Folder of scene folders.")
@click.option("--styles", type=FOLDER, required=True, help="Folder of paintings.")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), required=True,
    help="PNG for one sheet; a folder for one a scene.",
)  # fmt: skip
@click.option("--only", multiple=True, help="Name of a scene; may be repeated.")
@click.option("--scene-count", default=6, show_default=True, help="Scenes, evenly over the folder.")
@click.option(
    "--style-count", default=3, show_default=True,
    help="Paintings, evenly over every tenth of the folder, which training leaves alone.",
)  # fmt: skip
@click.option("--views", default=2, type=click.IntRange(2, 8), show_default=True)
@click.option("--size", default=256, show_default=True, help="Side of the pictures, pixels.")
@click.option(
    "--intrinsics", type=click.Choice(["true", "assumed"]), default="true", show_default=True,
    help="What the network is given.",
)  # fmt: skip
@click.option("--threads", default=1, show_default=True)
def main(
    model: Path, scenes: Path, styles: Path, output: Path, only: tuple[str, ...],
    scene_count: int, style_count: int, **options: Any,
) -> None:  # fmt: skip
    """Draw and write."""
    try:
        if options["size"] % PATCH:
            raise UsageError(f"--size {options['size']}: must be a multiple of {PATCH}")
        pictures = pick(held_out_styles(styles), style_count)
        chosen = [Style(path.stem, load_style(path, STYLE_SIDE).image) for path in pictures]
        plan = Plan(choose_scenes(scenes, only, scene_count), chosen, **options)
        rows = scene_rows(load_stylizer(model, plan.threads), plan)
        title = f"{model.name}, {plan.views} photos at {plan.size} x {plan.size}"
        write_gallery(output, title, list(rows))
    except Styl3rError as error:
        print(f"Error: {error}", file=sys.stderr)
        sys.exit(error.exit_code)


def choose_scenes(folder: Path, only: Sequence[str], count: int) -> list[Path]:
    """The named scenes, or some that training has not seen.

    Raises:
        InputError: there are no scenes.
        UsageError: a name is unknown.
    """
    folders = {path.name: path for path in scene_folders(folder)}
    for name in only:
        if name not in folders:
            raise UsageError(f"--only {name}: no such scene in {folder}")
    if only:
        return [folders[name] for name in only]
    return pick([path for name, path in folders.items() if name not in TRAINING_SCENES], count)


def scene_rows(stylizer: Stylizer, plan: Plan) -> Iterator[tuple[str, list[Row]]]:
    """Each scene's name and its rows, one a style; a scene with too few photos is left out."""
    for folder in plan.scenes:
        groups = choose_groups(load_scene(folder, plan.size), plan.views, 1)
        if not groups:
            print(f"Note: {folder.name}: no {plan.views} photos that overlap", file=sys.stderr)
            continue
        yield folder.name, draw_scene(stylizer, groups[0], plan)


def draw_scene(stylizer: Stylizer, group: Group, plan: Plan) -> list[Row]:
    """A row for each style: what goes in, and what comes out."""
    prediction = predict(stylizer, group, plan.intrinsics)
    cameras = prediction.recovered.cameras
    middle = camera_path(cameras, 3)[1]
    painter = Painter(stylizer, prediction.scene, prediction.recovered, plan.threads)
    own, _ = painter(strength=0.0)
    plain = [
        Cell(group.views[0].pixels, f"photo {group.views[0].name}"),
        *own_cells(own, cameras[0], plan),
    ]
    rows = []
    for style in plan.styles:
        heading = f"{group.scene.name}, in {style.name}{unplaced(prediction)}"
        stylized, _ = painter([style.image])
        cells = [
            Cell(seen(stylized, camera, plan), caption)
            for camera, caption in ((cameras[0], "stylized"), (middle, "stylized, a new view"))
        ]
        rows.append(Row(heading, [plain[0], style_cell(style, plan), *cells, *plain[1:]]))
    return rows


def unplaced(prediction: Prediction) -> str:
    """A remark on views whose cameras were not found."""
    lost = prediction.recovered.recovered.count(False)
    return f" ({lost} of {len(prediction.recovered.cameras)} cameras not found)" if lost else ""


def own_cells(own: Gaussians, camera: Camera, plan: Plan) -> list[Cell]:
    """The scene in its own colours, and its depth, as its first camera sees them."""
    frame = Drawing(threads=plan.threads).frame(own, camera)
    (depth,) = colour_depths([frame.depth], [frame.alpha > SOLID])
    return [
        Cell(to_picture(frame.colour), "own colours"),
        Cell(depth, "depth (red is near)"),
    ]


def seen(gaussians: Gaussians, camera: Camera, plan: Plan) -> Picture:
    """What a camera sees of the scene."""
    return to_picture(Drawing(threads=plan.threads).frame(gaussians, camera).colour)


def style_cell(style: Style, plan: Plan) -> Cell:
    """The painting, as large as the other pictures."""
    from PIL import Image

    picture = Image.fromarray(to_picture(style.image.transpose(1, 2, 0)))
    return Cell(np.asarray(fit_style(picture, plan.size)), f"style {style.name}")


def write_gallery(output: Path, title: str, scenes: Sequence[tuple[str, Sequence[Row]]]) -> None:
    """One sheet for all scenes, or one for each in a folder.

    Raises:
        InputError: there is nothing to draw.
        OutputError: a file cannot be written.
    """
    if not scenes:
        raise InputError("no scene has enough photos that overlap; give fewer --views")
    sheets = {output / f"{name}.png": list(rows) for name, rows in scenes}
    if output.suffix.lower() == ".png":
        sheets = {output: [row for _, rows in scenes for row in rows]}
    else:
        output.mkdir(parents=True, exist_ok=True)
    for path, rows in sheets.items():
        with atomic_write(path) as temporary:
            draw_sheet(title, rows).save(temporary, format="PNG")


if __name__ == "__main__":
    main()
