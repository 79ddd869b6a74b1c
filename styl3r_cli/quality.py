"""`--quality`: how large the work is, and what that costs and gives by measured points."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

QUALITIES = ("draft", "balanced", "best")
BEST = "best"
# Side of what is drawn in `render`, over that of the frames that it is enlarged to. Costs go with
# the square of it.
SHARES = {"draft": 0.5, "balanced": 0.75, BEST: 1.0}
# Side of the network's pictures in `stylize`, over that which it was trained at.
NETWORK_SHARES = {"draft": 0.5, "balanced": 1.0, BEST: 1.0}
# Whether colours are fitted to the views (see `painter`): the dearest step after the network.
FITTED = {"draft": False, "balanced": False, BEST: True}
# Whether a scene is left with only as many Gaussians as it requires (see `compaction`), where no
# option says: that takes time, which the others are chosen to save.
COMPACTED = {"draft": False, "balanced": False, BEST: True}
KEPT_DECIBELS = 45.0  # of 255 steps, errors of 1.4 on average: nobody sees them side by side
PATCH = 16  # sides of the network's pictures are multiples of it
# Written by `python -m styl3r_cli.tradeoff.presets`, which says how: never by hand.
MEASURED = Path(__file__).parent / "presets.json"


def network_size(quality: str, size: tuple[int, int]) -> tuple[int, int]:
    """(height, width) of the network's pictures, where `best` has `size`."""
    height, width = (max(round(s * NETWORK_SHARES[quality] / PATCH) * PATCH, PATCH) for s in size)
    return height, width


def measured() -> dict[str, Any]:
    """The measured points, with their command, machine and date; empty before any measurement."""
    return json.loads(MEASURED.read_text(encoding="utf-8"))


def help_of(command: str) -> str:
    """A line for a command's --help: time and decibels of every quality."""
    points = measured().get(command)
    if points is None:
        return "not measured yet"
    told = (
        f"{name} {_short(points[name]['seconds'])}"
        + (f", {points[name]['decibels']} dB" if name != BEST else "")
        for name in QUALITIES
    )
    return "; ".join(told)


def _short(seconds: float) -> str:
    return f"{seconds:.2f} s" if seconds >= 0.1 else f"{1e3 * seconds:.0f} ms"
