"""Command line: `python -m styl3r_export.evaluate MODEL --scenes FOLDER`, or other sources."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from styl3r_cli.errors import Styl3rError
from styl3r_cli.files import atomic_write
from styl3r_export.evaluate import table
from styl3r_export.evaluate.measure import measure
from styl3r_export.evaluate.records import Record, summarise
from styl3r_export.evaluate.settings import ROWS, TRAINING_SCENES, Settings

FILE = click.Path(exists=True, dir_okay=False, path_type=Path)
FOLDER = click.Path(exists=True, file_okay=False, path_type=Path)


@click.command(help="Measure a model on scenes with known cameras, beside baselines.")
@click.argument("model", type=click.Path(path_type=Path))
@click.option("--scenes", type=FOLDER, help="Folder of scene folders (real photos).")
@click.option("--shards", type=FOLDER, help="Folder of generated scenes that training never saw.")
@click.option("--re10k", type=FOLDER, help="Folder of RE10K chunks (.torch).")
@click.option("--index", type=FILE, help="Their evaluation index (JSON).")
@click.option("--colmap", type=FOLDER, help="COLMAP scene, or folder of such (Tanks and Temples).")
@click.option("--teachers", type=FOLDER, help="Folder of networks to measure with (LPIPS, ...).")
@click.option("--styles", type=FOLDER, help="Folder of paintings; every tenth is used.")
@click.option("--only", multiple=True, help="Name of a scene; may be repeated. Default: all.")
@click.option("--most", type=click.IntRange(min=1), help="Scenes of each folder, at most.")
@click.option("--rows", help=f"What to measure: {','.join(ROWS)}. Default: all that can be.")
@click.option("--views", default="2,4,8", show_default=True, help="Photos given at once.")
@click.option("--per-scene", default=4, show_default=True, help="Groups of photos a scene.")
@click.option(
    "--styled-per-scene", default=1, show_default=True,
    help="How many of them are stylized, which takes longest.",
)  # fmt: skip
@click.option("--size", default=256, show_default=True, help="Side of the crops, pixels.")
@click.option(
    "--intrinsics", type=click.Choice(["true", "assumed"]), default="true", show_default=True,
    help="What the network is given.",
)  # fmt: skip
@click.option(
    "--pose-steps", default=0, show_default=True,
    help="Also fit targets' cameras to their photos (published: 50); slow.",
)  # fmt: skip
@click.option(
    "--training-scene", "training_scenes", multiple=True, default=TRAINING_SCENES,
    show_default=True, help="A scene that training may have seen: reported apart.",
)  # fmt: skip
@click.option("--threads", default=1, show_default=True)
@click.option("--json", "output", type=click.Path(path_type=Path), help="Write all numbers here.")
def main(output: Path | None, rows: str | None, views: str, **options: Any) -> None:
    """Measure, print the table, write the numbers."""
    chosen = None if rows is None else _parts("--rows", rows, ROWS)
    counts = [int(count) for count in _parts("--views", views, tuple("2345678"))]
    settings = Settings(rows=chosen, views=counts, **options)
    try:
        records = list(measure(settings))
        sys.stdout.write(table.format_table(records))
        if output is not None:
            text = json.dumps(report(records, settings), indent=1) + "\n"
            with atomic_write(output) as path:
                path.write_text(text, encoding="utf-8")
    except Styl3rError as error:
        print(f"Error: {error}", file=sys.stderr)
        sys.exit(error.exit_code)


def report(records: Sequence[Record], settings: Settings) -> dict[str, Any]:
    """Everything, for programs: settings, summaries, and each group's numbers."""
    found = table.sections(records)
    return {
        "settings": settings.to_dict(),
        "summaries": [s.to_dict() for section in found for s in summarise(records, *section)],
        "areas": [
            {"kind": kind, "views": views, "auc": table.areas(records, kind, views)}
            for kind, views in found
        ],
        "groups": [record.to_dict() for record in records],
    }


def _parts(option: str, text: str, allowed: Sequence[str]) -> list[str]:
    """A comma-separated choice."""
    parts = [part.strip() for part in text.split(",") if part.strip()]
    if not parts or any(part not in allowed for part in parts):
        raise click.UsageError(f"{option} {text}: a list of {', '.join(allowed)}")
    return parts


if __name__ == "__main__":
    main()
