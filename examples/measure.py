"""Times and memory of the main job on this machine: `python examples/measure.py`."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

from styl3r_cli.photos import load_photos, load_style
from styl3r_cli.pipeline import Stylizer
from styl3r_cli.sessions import available_cores

HERE = Path(__file__).parent
PHOTOS = sorted(HERE.glob("room/*.jpg"))
STYLE = HERE / "styles" / "night.jpg"
ROUNDS = 5
KIB_PER_MB = 1e6 / 1024  # ru_maxrss is in KiB on Linux


def cold_start() -> None:
    """From the start of the process to the scene on disk, with two photos."""
    walls, processor, peak = [], [], 0.0
    with tempfile.TemporaryDirectory() as folder:
        target = str(Path(folder) / "scene.ply")
        photos = [str(path) for path in PHOTOS[1:3]]
        command = [sys.executable, "-m", "styl3r_cli", "stylize", *photos, "-s", str(STYLE)]
        for _ in range(ROUNDS):
            start = time.perf_counter()
            process = subprocess.Popen([*command, "-o", target, "--quiet"])
            _, status, usage = os.wait4(process.pid, 0)
            walls.append(time.perf_counter() - start)
            if status:
                sys.exit("the command failed")
            processor.append(usage.ru_utime + usage.ru_stime)
            peak = max(peak, usage.ru_maxrss / KIB_PER_MB)
    print(f"cold start, 2 photos: {_seconds(walls)}, processor {_seconds(processor)}")
    print(f"its peak memory: {peak:.0f} MB")


def warm_graphs(views: int) -> None:
    """Each graph on its own, loaded for many scenes, after one run."""
    stylizer = Stylizer("mini")
    photos = load_photos(PHOTOS[:views] if views > 2 else PHOTOS[1:3])
    style = load_style(STYLE).image
    scene = stylizer.encode(photos)
    structure = _timed(lambda: stylizer.encode(photos))
    appearance = _timed(lambda: stylizer.colours(scene, [style]))
    print(f"warm graphs, {views} photos: structure {structure}, appearance {appearance}")


def _timed(work: Callable[[], object]) -> str:
    work()
    times = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return _seconds(times)


def _seconds(times: list[float]) -> str:
    return f"{median(times):.2f} s (best {min(times):.2f})"


if __name__ == "__main__":
    print(f"{available_cores()} cores, load {os.getloadavg()[0]:.1f}; medians of {ROUNDS}")
    cold_start()
    warm_graphs(2)
    warm_graphs(4)
