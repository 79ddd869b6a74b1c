"""Measurements as rows: medians, agreement with the reference, and what is recommended."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from styl3r_cli.gaussians import Gaussians
from styl3r_cli.tradeoff.agreement import (
    ATTRIBUTES,
    BROKEN_DB,
    Difference,
    View,
    compare_pictures,
    differences,
)
from styl3r_cli.tradeoff.agreement import worst as worst_of
from styl3r_cli.tradeoff.bench import Bench
from styl3r_cli.tradeoff.points import AS_NEEDED, Point
from styl3r_cli.tradeoff.truth import Truth

# Agreement in every view that deserves a name: at 40 dB pictures that alternate on a screen show
# no difference, at 35 dB it has to be looked for, at 30 dB it is seen side by side.
CLASSES = {"no visible loss": 40.0, "hardly visible loss": 35.0, "visible loss": BROKEN_DB}
# What it takes from photos in memory to a scene.
STAGES = ("structure", "cameras", "appearance", "compact")
MEGABYTE = 1e6


@dataclass
class Row:
    """One point, measured.

    Attributes:
        point: the setting.
        seconds: medians by stage; "scene" is `STAGES` together.
        memory: largest of the repeats, bytes.
        bytes: of the scene's .ply.
        model_bytes: of the graphs.
        gaussians: how many.
        repeats: how often it was measured.
        attributes: how far the Gaussians are off, where they correspond.
        views: how alike its pictures are to the reference's.
        errors: how far it is from what is known to be true, see `Truth.errors`.
        failed: why there is nothing to show, or "".
    """

    point: Point
    seconds: dict[str, float] = field(default_factory=dict)
    memory: int = 0
    bytes: int = 0
    model_bytes: int = 0
    gaussians: int = 0
    repeats: int = 0
    attributes: dict[str, Difference] = field(default_factory=dict)
    views: list[View] = field(default_factory=list)
    errors: dict[str, float] = field(default_factory=dict)
    failed: str = ""

    @property
    def worst(self) -> float:
        """PSNR at the view that agrees least; not a number without pictures."""
        return worst_of(self.views)

    def rejected(self, reference: Point) -> bool:
        """Whether its precision breaks the scene: shown, and never offered."""
        lower = self.point.precision != reference.precision
        return bool(self.failed) or (lower and not self.worst >= BROKEN_DB)


def collect(bench: Bench, points: Sequence[Point], truth: Truth) -> list[Row]:
    """A row for each point that has been measured, the reference first.

    Args:
        bench: what was measured.
        points: all of them.
        truth: what to compare with.
    """
    reference = _arrays(bench, points[0])
    rows = []
    for point in points:
        results = list(bench.repeats_of(point))
        if not results:
            continue
        if "failed" in results[0]:
            rows.append(Row(point, failed=results[0]["failed"]))
            continue
        rows.append(_row(bench, point, results, reference, truth))
    return rows


def _row(
    bench: Bench,
    point: Point,
    results: Sequence[dict[str, Any]],
    reference: dict[str, np.ndarray] | None,
    truth: Truth,
) -> Row:
    stages = results[0]["seconds"]
    seconds = {s: statistics.median(r["seconds"][s] for r in results) for s in stages}
    seconds["scene"] = sum(seconds[stage] for stage in STAGES)
    made = _arrays(bench, point)
    row = Row(
        point,
        seconds,
        max(result["memory"] for result in results),
        results[0]["bytes"],
        model_bytes(bench.models[point.precision]),
        results[0]["gaussians"],
        len(results),
    )
    if made is None or reference is None:
        return row
    row.attributes = differences(*corresponding(made, reference))
    row.views = _views(made, reference)
    row.errors = truth.errors(made)
    return row


def _views(made: dict[str, np.ndarray], reference: dict[str, np.ndarray]) -> list[View]:
    """Pictures from the views that both scenes have, and from between them."""
    views, all_views = int(made["views"]), int(reference["views"])
    seen = [*range(views), *range(all_views, all_views + views - 1)]
    return compare_pictures(list(made["pictures"]), [reference["pictures"][i] for i in seen], views)


def _arrays(bench: Bench, point: Point) -> dict[str, np.ndarray] | None:
    path = bench.arrays_of(point)
    if not path.is_file():
        return None
    with np.load(path) as stored:
        return dict(stored)


def corresponding(
    made: dict[str, np.ndarray], reference: dict[str, np.ndarray]
) -> tuple[Gaussians, Gaussians]:
    """Both scenes' Gaussians of the pixels that are in both; none where they are not of pixels.

    Which of two views' Gaussians stands for a surface may be decided by rounding.
    """
    scenes = [Gaussians(*(each[name] for name in ATTRIBUTES)) for each in (made, reference)]
    pixels = [each["pixels"] for each in (made, reference)]
    of_pixels = [len(scene) == int(each.sum()) for scene, each in zip(scenes, pixels, strict=True)]
    if not all(of_pixels) or pixels[0].shape != pixels[1].shape:
        return scenes[0].select(np.zeros(0, np.intp)), scenes[1].select(np.zeros(0, np.intp))
    both = pixels[0] & pixels[1]
    first, second = (scene.select(both[each]) for scene, each in zip(scenes, pixels, strict=True))
    return first, second


def model_bytes(folder: str) -> int:
    """Bytes of a model's graphs."""
    from styl3r_cli.graphs import find
    from styl3r_cli.manifest import read_manifest

    return sum(entry.bytes for entry in read_manifest(find(folder)).files.values())


@dataclass(frozen=True)
class Advice:
    """The best setting of one accuracy class: `name` says best in what."""

    accuracy: str
    decibels: float
    name: str
    row: Row


def advise(rows: Sequence[Row]) -> list[Advice]:
    """The fastest setting and the smallest scene within each accuracy class."""
    reference = rows[0].point
    advice = []
    for accuracy, decibels in CLASSES.items():
        able = [r for r in rows if not r.rejected(reference) and r.worst >= decibels]
        if able:
            fastest = min(able, key=lambda row: row.seconds["scene"])
            smallest = min(able, key=lambda row: row.bytes)
            advice.append(Advice(accuracy, decibels, "fastest scene", fastest))
            advice.append(Advice(accuracy, decibels, "smallest scene", smallest))
    return advice


def flags(point: Point, reference: Point) -> str:
    """What to add to a command line to get a point's setting."""
    parts = []
    if point.precision != reference.precision:
        parts.append(f"--model DIR (styl3r export MODEL -o DIR --precision {point.precision})")
    if point.size != reference.size:
        parts.append(f"--size {point.size}")
    if point.views != reference.views:
        parts.append(f"the first {point.views} photos")
    if point.threads != reference.threads:
        parts.append(f"--threads {point.threads}")
    if point.budget != reference.budget:
        kept = f"{point.budget:g} % of the Gaussians (styl3r compact)"
        parts.append("stylize as it is" if point.budget == AS_NEEDED else kept)
    if point.colours != reference.colours:
        parts.append("--quality balanced")
    if point.drawing == "antialias":
        parts.append("render --antialias")
    elif point.drawing != reference.drawing:
        parts.append(f"render --quality {point.drawing}")
    return ", ".join(parts) or "the reference's own"
