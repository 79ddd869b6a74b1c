"""Measure what `--quality` promises, and write it down: `python -m styl3r_cli.tradeoff.presets`.

Run it at the repository's root whenever the bundled model or the renderer changes.
"""

from __future__ import annotations

import datetime
import json
import math
import statistics
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from styl3r_cli.files import atomic_write
from styl3r_cli.graphs import find
from styl3r_cli.limits import available_cores
from styl3r_cli.manifest import read_manifest
from styl3r_cli.quality import BEST, COMPACTED, FITTED, MEASURED, QUALITIES, network_size
from styl3r_cli.splatting.timing import machine
from styl3r_cli.tradeoff.bench import Bench
from styl3r_cli.tradeoff.points import AS_NEEDED, COLOURS, GIVEN, WHOLE, Point
from styl3r_cli.tradeoff.rows import Row, collect
from styl3r_cli.tradeoff.truth import Truth

EXAMPLE = Path("examples/room")
STYLES = ("night", "ink", "wave")
SIDE = 256  # of the pictures that the bundled model was trained on
# Of the frames that are drawn: of `stylize` as large as the photos', of `render` as by default.
FRAME_SIDES = {"stylize": SIDE, "render": 512}
MARGIN = 1.0  # decibels less than measured are promised: other processors round differently


def points() -> dict[str, dict[str, Point]]:
    """The point of each quality, by command; `best` is the reference of `render`."""
    best = reference()
    stylize = {
        quality: replace(
            best,
            budget=AS_NEEDED if COMPACTED[quality] else WHOLE,
            size=network_size(quality, (SIDE, SIDE))[0],
            colours=COLOURS[0] if FITTED[quality] else COLOURS[1],
        )
        for quality in QUALITIES
    }
    drawn = {BEST: "exact", "balanced": "balanced", "draft": "draft"}
    render = {quality: replace(best, drawing=drawn[quality]) for quality in QUALITIES}
    return {"stylize": stylize, "render": render}


def reference() -> Point:
    """What all others are compared with: the best, with every Gaussian."""
    return Point(GIVEN, SIDE, len(photos()), WHOLE, "exact", available_cores())


def photos() -> list[Path]:
    """The example's photos."""
    return sorted(EXAMPLE.glob("*.jpg"))


def measure(repeats: int) -> dict[str, Any]:
    """What each quality takes and keeps: medians over styles, the worst view of all styles."""
    found = {}
    for command, wanted in points().items():
        every = list(dict.fromkeys([reference(), *wanted.values()]))
        by_style = [_measured(style, every, FRAME_SIDES[command], repeats) for style in STYLES]
        found[command] = {
            quality: _promise(command, point, by_style) for quality, point in wanted.items()
        }
    return found


def _measured(style: str, every: Sequence[Point], side: int, repeats: int) -> dict[Point, Row]:
    """Every point's row with frames of side x side pixels."""
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(
            Path(folder),
            photos(),
            [Path("examples/styles") / f"{style}.jpg"],
            None,
            (side, side),
            {GIVEN: str(find("mini"))},
        )
        bench.run(every, repeats)
        return {row.point: row for row in collect(bench, every, Truth())}


def _promise(command: str, point: Point, rows: list[dict[Point, Row]]) -> dict[str, Any]:
    stage = {"stylize": "scene", "render": "frame"}[command]
    worst = min(row[point].worst for row in rows)
    return {
        "decibels": math.floor(worst - MARGIN),
        "measured_decibels": round(worst, 2),
        "median_decibels": round(
            statistics.median(view.psnr for row in rows for view in row[point].views), 2
        ),
        "seconds": round(statistics.median(row[point].seconds[stage] for row in rows), 4),
        "memory_megabytes": round(max(row[point].memory for row in rows) / 1e6),
    }


@click.command()
@click.option("--repeats", default=3, show_default=True, help="Medians are taken of them.")
def main(repeats: int) -> None:
    """Measure the presets on the example scene, and write styl3r_cli/presets.json."""
    found = machine()
    manifest = read_manifest(find("mini"))
    report = {
        "command": "python -m styl3r_cli.tradeoff.presets",
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "machine": f"{found['processor']}, {found['cores']} cores, {found['system']}",
        "model": f"mini {manifest.model_version}",
        "weights_id": manifest.weights_id,
        "scene": f"{EXAMPLE.as_posix()}, {len(photos())} photos, styles {', '.join(STYLES)}",
        "repeats": repeats,
        **measure(repeats),
    }
    with atomic_write(MEASURED) as temporary:
        temporary.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    click.echo(MEASURED.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
