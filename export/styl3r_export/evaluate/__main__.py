"""Command line: `python -m styl3r_export.evaluate MODEL --scenes FOLDER`."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import click
import cv2
import torch

from styl3r_cli.errors import Styl3rError
from styl3r_cli.files import atomic_write
from styl3r_export.evaluate import predict, table
from styl3r_export.evaluate.depth import depth_values
from styl3r_export.evaluate.groups import Group, choose_groups
from styl3r_export.evaluate.poses import camera_values
from styl3r_export.evaluate.records import Record, Values, summarise
from styl3r_export.evaluate.scenes import load_scene, scene_folders

ROWS = ("depth", "cameras")
# Scenes whose licences allow shipped weights to be trained on them.
TRAINING_SCENES = ("box_shelf", "church_door", "office_desk")


@click.command(help="Measure a model on real photos, beside baselines.")
@click.argument("model", type=click.Path(path_type=Path))
@click.option(
    "--scenes", "root", required=True, help="Folder of scene folders.",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
)  # fmt: skip
@click.option("--only", multiple=True, help="Name of a scene; may be repeated. Default: all.")
@click.option("--rows", default=",".join(ROWS), show_default=True, help="What to measure.")
@click.option("--views", default="2,4", show_default=True, help="Photos given at once.")
@click.option("--per-scene", default=4, show_default=True, help="Groups of photos a scene.")
@click.option("--size", default=256, show_default=True, help="Side of the crops, pixels.")
@click.option(
    "--intrinsics", type=click.Choice(["true", "assumed"]), default="true", show_default=True,
    help="What the network is given.",
)  # fmt: skip
@click.option(
    "--training-scene", multiple=True, default=TRAINING_SCENES, show_default=True,
    help="A scene that training may have seen: reported apart.",
)  # fmt: skip
@click.option("--threads", default=1, show_default=True)
@click.option("--json", "output", type=click.Path(path_type=Path), help="Write all numbers here.")
def main(output: Path | None, **options: Any) -> None:
    """Measure, print the table, write the numbers."""
    try:
        records = list(measure(**options))
        sys.stdout.write(table.format_table(records))
        if output is not None:
            text = json.dumps(report(records, options), indent=1, default=str) + "\n"
            with atomic_write(output) as path:
                path.write_text(text, encoding="utf-8")
    except Styl3rError as error:
        print(f"Error: {error}", file=sys.stderr)
        sys.exit(error.exit_code)


def measure(
    model: Path,
    root: Path,
    only: Sequence[str],
    rows: str,
    views: str,
    per_scene: int,
    size: int,
    intrinsics: predict.Intrinsics,
    training_scene: Sequence[str],
    threads: int,
) -> Iterator[Record]:
    """The numbers of each group of each scene."""
    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)
    wanted = _parts(rows, ROWS)
    counts = [int(count) for count in _parts(views, tuple("2345678"))]
    stylizer = predict.load_stylizer(model, threads)
    folders = [path for path in scene_folders(root) if not only or path.name in only]
    for done, folder in enumerate(folders, 1):
        scene = load_scene(folder, size)
        kind = "training" if folder.name in training_scene else "validation"
        for count in counts:
            for group in choose_groups(scene, count, per_scene):
                values = group_values(stylizer, group, wanted, intrinsics)
                yield Record.of(kind, group, values)
        if sys.stderr.isatty():
            print(f"\r{done}/{len(folders)} scenes", end="", file=sys.stderr)


def group_values(
    stylizer: predict.Stylizer, group: Group, rows: Sequence[str], intrinsics: predict.Intrinsics
) -> Values:
    """All rows of one group."""
    prediction = predict.predict(stylizer, group, intrinsics)
    cameras = prediction.recovered.cameras
    values: Values = {}
    if "depth" in rows:
        values |= depth_values(group, prediction.scene.means, cameras)
    if "cameras" in rows:
        assumed = predict.assumed_focal(group.views[0])
        values |= camera_values(group, prediction.recovered, prediction.given, assumed)
    return values


def report(records: Sequence[Record], options: dict[str, Any]) -> dict[str, Any]:
    """Everything, for programs: settings, summaries, and each group's numbers."""
    found = table.sections(records)
    return {
        "settings": options,
        "summaries": [s.to_dict() for section in found for s in summarise(records, *section)],
        "areas": [
            {"kind": kind, "views": views, "auc": table.areas(records, kind, views)}
            for kind, views in found
        ],
        "groups": [record.to_dict() for record in records],
    }


def _parts(text: str, allowed: Sequence[str]) -> list[str]:
    """A comma-separated choice."""
    parts = [part.strip() for part in text.split(",") if part.strip()]
    unknown = [part for part in parts if part not in allowed]
    if unknown or not parts:
        raise click.BadParameter(f"'{text}': a list of {', '.join(allowed)}")
    return parts


if __name__ == "__main__":
    main()
