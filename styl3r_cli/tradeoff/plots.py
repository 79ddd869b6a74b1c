"""Agreement against cost, as drawings inside a page (SVG); matplotlib draws them."""

from __future__ import annotations

import io
from collections.abc import Sequence
from importlib.util import find_spec

from styl3r_cli.tradeoff.rows import CLASSES, MEGABYTE, Row

COSTS = {
    "seconds for a scene": lambda row: row.seconds["scene"],
    "milliseconds a frame": lambda row: 1e3 * row.seconds["frame"],
    "MB of memory": lambda row: row.memory / MEGABYTE,
    "MB of the scene's file": lambda row: row.bytes / MEGABYTE,
    "MB of the model": lambda row: row.model_bytes / MEGABYTE,
}
MOST_DECIBELS = 70.0  # better agreement than this is drawn here, or it would flatten the rest
SIZE = (5.2, 3.6)  # inches


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
    pairs = [(COSTS[name](row), min(row.worst, MOST_DECIBELS)) for row in rows]
    good = [not row.rejected(reference.point) for row in rows]
    front = [pairs[i] for i in pareto(pairs) if good[i]]
    axes.plot(*zip(*front, strict=True), color="#888", lw=1, drawstyle="steps-post", zorder=1)
    for row, (cost, decibels), fine in zip(rows, pairs, good, strict=True):
        axes.scatter(cost, decibels, s=28, marker="o" if fine else "x", zorder=2)
        label = turned(row, reference)
        axes.annotate(label, (cost, decibels), (4, 3), textcoords="offset points", fontsize=6)
    for accuracy, limit in CLASSES.items():
        axes.axhline(limit, color="#ccc", lw=0.6, ls="--", zorder=0)
        axes.text(1, limit, accuracy, transform=axes.get_yaxis_transform(), fontsize=6, ha="right")
    axes.set_xlabel(name)
    axes.set_ylabel("agreement, worst view (dB)")
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None})
    pyplot.close(figure)
    svg = text.getvalue()
    return svg[svg.index("<svg") :]
