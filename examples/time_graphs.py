"""Seconds of the loaded graphs: `python examples/time_graphs.py PHOTO... STYLE`."""

from __future__ import annotations

import statistics
import sys
import time
from pathlib import Path

from styl3r_cli.photos import load_photos, load_style
from styl3r_cli.pipeline import Stylizer

REPEATS = 9  # medians of these, after one run to warm up


def main() -> None:
    """Time both graphs of the model that ships with the package."""
    *photos, style = (Path(argument) for argument in sys.argv[1:])
    stylizer, loaded, painting = Stylizer("mini"), load_photos(photos), load_style(style)
    structure, appearance = [], []
    for _ in range(REPEATS + 1):
        start = time.perf_counter()
        scene = stylizer.encode(loaded)
        between = time.perf_counter()
        stylizer.colours(scene, [painting.image])
        structure.append(between - start)
        appearance.append(time.perf_counter() - between)
    seconds = [statistics.median(times[1:]) for times in (structure, appearance)]
    print(f"structure {seconds[0]:.3f} s, appearance {seconds[1]:.3f} s")


if __name__ == "__main__":
    main()
