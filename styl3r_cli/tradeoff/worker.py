"""One point, measured in a process of its own: its times, its memory and its pictures."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np

from styl3r_cli import endings, memory
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.depth_errors import view_depths
from styl3r_cli.cameras.photo_frames import known_cameras
from styl3r_cli.cameras.poses import centre
from styl3r_cli.errors import ExitCode, OutputError, Styl3rError
from styl3r_cli.files import atomic_write
from styl3r_cli.formats import encode_scene
from styl3r_cli.frames import Drawing, Picture, coarse, colours
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.locate import locate_views
from styl3r_cli.painter import Painter
from styl3r_cli.photos import load_photos, load_style
from styl3r_cli.pipeline import Stylizer
from styl3r_cli.quality import KEPT_DECIBELS, SHARES
from styl3r_cli.tradeoff.agreement import ATTRIBUTES, between
from styl3r_cli.tradeoff.bench import AGAIN, UNWRITABLE
from styl3r_cli.tradeoff.points import AS_NEEDED, WHOLE

LOOK = 0.5  # seconds between two looks whether anybody waits for the result
KILOBYTES = 1024  # Linux counts a process's memory in them, macOS in bytes


class Stopwatch:
    """Seconds by stage, of the last time that each ran."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Time a block."""
        start = time.perf_counter()
        yield
        self.seconds[stage] = time.perf_counter() - start


def measure(job: dict[str, Any]) -> dict[str, Any]:
    """Run a job: everything once to warm up, then once for its times.

    Args:
        job: what `Bench.job` made.

    Returns:
        Seconds by stage, the process's largest memory, bytes of the scene's file, Gaussians.
    """
    point, watch = job["point"], Stopwatch()
    threads = point["threads"]
    with watch("photos"):
        paths = [Path(name) for name in job["photos"][: point["views"]]]
        known = known_cameras(Path(job["cameras"]), paths)[0] if job["cameras"] else None
        photos = load_photos(paths, (point["size"], point["size"]), job["fov"], known)
        styles = [load_style(Path(name)).image for name in job["styles"]]
    with watch("load"):
        stylizer = Stylizer(job["model"], "cpu", threads)
    start = time.perf_counter()
    for _ in range(2):
        with watch("structure"):
            scene = stylizer.encode(photos)
        with watch("cameras"):
            scene, found = locate_views(scene, photos, threads)
        painter = Painter(stylizer, scene, found, threads, point["colours"] == "fitted")
        with watch("appearance"):
            gaussians, _ = painter(styles, strength=1.0 if styles else 0.0)
        with watch("compact"):
            if point["budget"] == AS_NEEDED:
                gaussians = painter.compact(gaussians, KEPT_DECIBELS).gaussians
            else:
                gaussians = compact_to(gaussians, found.cameras, point["budget"], threads)
        watch.seconds.setdefault("first run", time.perf_counter() - start)
    cameras = [camera.resized(*job["frame"]) for camera in found.cameras]
    for _ in range(2):
        with watch("frame"):
            frame(gaussians, cameras[0], point["drawing"], threads)
    result = {
        "seconds": watch.seconds,
        "memory": peak_memory(),
        "bytes": len(encode_scene(gaussians, {}).data),
        "gaussians": len(gaussians),
    }
    if job["pictures"]:
        _save(Path(job["pictures"]), job, painter, gaussians, cameras)
    return result


def compact_to(
    gaussians: Gaussians, cameras: Sequence[Camera], percent: float, threads: int | None
) -> Gaussians:
    """That share of a scene's Gaussians, so that its cameras see as little difference as may be."""
    if percent >= WHOLE:
        return gaussians
    from styl3r_cli.compaction import keep_count, witnesses

    count = max(round(len(gaussians) * percent / WHOLE), 1)
    return keep_count(gaussians, witnesses(cameras, gaussians), count, threads).gaussians


def frame(gaussians: Gaussians, camera: Camera, drawing: str, threads: int) -> Picture:
    """One picture, drawn as the point says."""
    antialias = drawing == "antialias"
    look = colours(gaussians, Drawing(threads=threads, antialias=antialias))
    return coarse(look, SHARES.get(drawing, 1.0))(camera, 0.0)


def _save(
    path: Path,
    job: dict[str, Any],
    painter: Painter,
    gaussians: Gaussians,
    cameras: Sequence[Camera],
) -> None:
    """What agreement is computed from: the Gaussians, and pictures from and between the views."""
    drawing, threads = job["point"]["drawing"], job["point"]["threads"]
    seen = [*cameras, *between(cameras)]
    arrays = {name: getattr(gaussians, name) for name in ATTRIBUTES}
    arrays["pixels"] = painter.pixels
    arrays["pictures"] = np.stack([frame(gaussians, camera, drawing, threads) for camera in seen])
    arrays["views"] = np.array(len(cameras))
    arrays["poses"] = np.stack([camera.extrinsics for camera in cameras])
    if job["depths"]:
        views = zip(painter.scene.means, cameras, strict=True)
        arrays["depths"] = np.stack([view_depths(*view) for view in views]).astype(np.float32)
    truths = _truths(job, painter, cameras)
    if truths:
        arrays["held_out"] = np.stack(truths)
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)


def _truths(job: dict[str, Any], painter: Painter, cameras: Sequence[Camera]) -> list[Picture]:
    """What held-out cameras see of the scene in its own colours, compacted and drawn alike."""
    if not job["held_out"]:
        return []
    point = job["point"]
    own, _ = painter(strength=0.0)
    if point["budget"] != AS_NEEDED:
        own = compact_to(own, cameras, point["budget"], point["threads"])
    poses = [np.array(pose) for pose in job["held_out"]["views"]]
    scale = relative_scale([camera.extrinsics for camera in cameras], poses)
    pictures = []
    for pose in job["held_out"]["poses"]:
        moved = np.array(pose)
        moved[:3, 3] *= scale
        camera = replace(cameras[0], extrinsics=moved)
        pictures.append(frame(own, camera, point["drawing"], point["threads"]))
    return pictures


def relative_scale(ours: Sequence[np.ndarray], theirs: Sequence[np.ndarray]) -> float:
    """How much larger our scene is than theirs, by the distances of its cameras from the first.

    Both have the first view's camera as the world, so that a scale is all they can differ by.
    """
    pairs = [
        (float(np.linalg.norm(centre(a))), float(np.linalg.norm(centre(b))))
        for a, b in zip(ours[1:], theirs[1:], strict=False)
    ]
    ratios = [a / b for a, b in pairs if a > 0 and b > 0]
    return float(np.median(ratios)) if ratios else 1.0


def peak_memory() -> int:
    """Bytes of memory that this process has held at most; 0 where the system does not tell."""
    # Linux hands getrusage's peak down to a started process, as if its parent's were its own.
    with suppress(OSError):
        lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
        peaks = [int(line.split()[1]) for line in lines if line.startswith("VmHWM:")]
        if peaks:
            return peaks[0] * KILOBYTES
    try:
        import resource
    except ImportError:  # Windows
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * KILOBYTES)


def _end_without(parent: int) -> None:
    """End when the process that asked has been killed: another run's times would suffer."""
    while os.getppid() == parent:
        time.sleep(LOOK)
    endings.leave(ExitCode.INTERNAL)


def main() -> None:
    """A job on standard input; its result, or what went wrong, on standard output."""
    job = json.load(sys.stdin)
    Thread(target=_end_without, args=(os.getppid(),), daemon=True).start()
    try:
        result = measure(job)
    except OutputError as error:
        result = {UNWRITABLE: str(error)}
    except Styl3rError as error:
        result = {"failed": str(error), AGAIN: memory.ended(error)}
    except MemoryError:
        result = {"failed": "out of memory", AGAIN: True}
    json.dump(result, sys.stdout)


if __name__ == "__main__":
    main()
