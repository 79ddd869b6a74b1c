"""Agreement against cost, as drawings inside a page (SVG); matplotlib draws them."""

from __future__ import annotations

import io
from collections.abc import Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING, Literal

from styl3r_cli.tradeoff.rows import CLASSES, MEGABYTE, Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.text import Annotation
    from matplotlib.transforms import Bbox

Horizontal = Literal["left", "center", "right"]
Vertical = Literal["bottom", "top"]

COSTS = {
    "seconds for a scene": lambda row: row.seconds["scene"],
    "milliseconds a frame": lambda row: 1e3 * row.seconds["frame"],
    "MB of memory": lambda row: row.memory / MEGABYTE,
    "MB of the scene's file": lambda row: row.bytes / MEGABYTE,
    "MB of the model": lambda row: row.model_bytes / MEGABYTE,
}
MOST_DECIBELS = 70.0  # better agreement than this is drawn here, or it would flatten the rest
SIZE = (5.2, 3.6)  # inches
FRONT, REST, BROKEN, LINES = "#1a1a1a", "#4c78a8", "#c44e52", "#bbbbbb"
POINT, LABEL = 22, 6  # square points, points
# Where a label may stand beside its point: offset in points, and which side of it is there.
PLACES: tuple[tuple[int, int, Horizontal, Vertical], ...] = (
    (4, 2, "left", "bottom"),
    (-4, 2, "right", "bottom"),
    (4, -2, "left", "top"),
    (-4, -2, "right", "top"),
    (0, 5, "center", "bottom"),
    (0, -5, "center", "top"),
)


def available() -> bool:
    """Whether matplotlib is installed."""
    return find_spec("matplotlib") is not None


def turned(row: Row, reference: Row) -> str:
    """The dials that differ from the reference's, in words."""
    ours, theirs = row.point.to_dict(), reference.point.to_dict()
    parts = [f"{dial} {ours[dial]}" for dial in ours if ours[dial] != theirs[dial]]
    return ", ".join(parts) or "reference"


def pareto(rows: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of the (cost, agreement) pairs that no other beats in both, by rising cost."""
    best, kept = float("-inf"), []
    for index in sorted(range(len(rows)), key=lambda i: (rows[i][0], -rows[i][1])):
        if rows[index][1] > best:
            best = rows[index][1]
            kept.append(index)
    return kept


def draw(rows: Sequence[Row]) -> list[str]:
    """One SVG per cost; rejected settings are crosses."""
    shown = [row for row in rows if not row.failed and row.views]
    return [_plot(name, shown, rows[0]) for name in COSTS] if shown else []


def _plot(name: str, rows: Sequence[Row], reference: Row) -> str:
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "styl3r"  # the same rows give the same bytes
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=SIZE, layout="constrained")
    axes.margins(0.12, 0.08)  # room for labels
    pairs = [(COSTS[name](row), min(row.worst, MOST_DECIBELS)) for row in rows]
    good = [not row.rejected(reference.point) for row in rows]
    front = [i for i in pareto(pairs) if good[i]]
    steps = [pairs[i] for i in front]
    axes.plot(*zip(*steps, strict=True), color=LINES, lw=1, drawstyle="steps-post", zorder=1)
    for i, (pair, fine) in enumerate(zip(pairs, good, strict=True)):
        colour = BROKEN if not fine else FRONT if i in front else REST
        axes.scatter(*pair, s=POINT, marker="o" if fine else "x", color=colour, zorder=2)
    for accuracy, limit in CLASSES.items():
        axes.axhline(limit, color=LINES, lw=0.6, ls="--", zorder=0)
        axes.text(
            0.01, limit, accuracy, transform=axes.get_yaxis_transform(), fontsize=LABEL,
            color="#777777", va="bottom",
        )  # fmt: skip
    axes.set_xlabel(name)
    axes.set_ylabel("agreement, worst view (dB)")
    _label(axes, pairs, [turned(row, reference) for row in rows])
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None})
    pyplot.close(figure)
    svg = text.getvalue()
    return svg[svg.index("<svg") :]


def _label(axes: Axes, pairs: Sequence[tuple[float, float]], names: Sequence[str]) -> None:
    """Write each point's name beside it, where it covers the fewest others and stays inside."""
    axes.figure.draw_without_rendering()  # type: ignore[union-attr]  # where everything is
    taken = [each.get_window_extent() for each in axes.texts]
    taken += [each.get_window_extent() for each in axes.collections]
    for pair, name in sorted(zip(pairs, names, strict=True), key=lambda each: -each[0][1]):
        tried: list[tuple[float, int, Annotation, Bbox]] = []
        for x, y, ha, va in PLACES:
            text = axes.annotate(
                name, pair, (x, y), textcoords="offset points", fontsize=LABEL, ha=ha, va=va
            )
            text.set_in_layout(False)
            box = text.get_window_extent()
            inside = axes.bbox.x0 <= box.x0 and box.x1 <= axes.bbox.x1
            tried.append((box.count_overlaps(taken) + 2 * (not inside), len(tried), text, box))
        best = min(tried, key=lambda each: each[:2])
        taken.append(best[3])
        for each in tried:
            if each is not best:
                each[2].remove()
