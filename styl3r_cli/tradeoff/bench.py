"""All points, repeated and interleaved, with a journal that an interrupted run goes on from."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from styl3r_cli.tradeoff.points import Point

JOURNAL = "measured.jsonl"
COUNTED = ("memory", "bytes", "gaussians")  # in a result, beside its seconds
# What reading fails with where an editor or a full disk was at it.
DAMAGED = (LookupError, TypeError, AttributeError, ValueError, OSError, EOFError, BadZipFile)
LAST_LINES = 200  # characters of a crashed worker's complaint that are worth telling


@dataclass
class Bench:
    """What is measured, and what has been.

    Attributes:
        folder: of the report; the journal and the pictures' arrays lie in it.
        photos: the views' files.
        styles: style pictures' files; none for the scene's own colours.
        fov: horizontal field of view in degrees, or None.
        frame: (width, height) of the pictures that are compared.
        models: the model folder of each precision.
        held_out: poses of held-out photos and of the views in one world, or None.
        cameras: a file of the photos' true cameras, or None; their lenses are the network's too.
        depths: whether the views' depths are kept too, to be compared with true ones.
        results: by point and repeat.
    """

    folder: Path
    photos: Sequence[Path]
    styles: Sequence[Path]
    fov: float | None
    frame: tuple[int, int]
    models: dict[str, str]
    held_out: dict[str, Any] | None = None
    cameras: Path | None = None
    depths: bool = False
    results: dict[tuple[str, int], dict[str, Any]] = field(default_factory=dict)

    def fingerprint(self) -> str:
        """The same for the same inputs, so that no journal is continued with others."""
        files = [*self.photos, *self.styles]
        told = [(str(path.resolve()), path.stat().st_size) for path in files]
        models = {
            name: hashlib.sha256((Path(folder) / "manifest.json").read_bytes()).hexdigest()
            for name, folder in self.models.items()
        }
        cameras = self.cameras and hashlib.sha256(self.cameras.read_bytes()).hexdigest()
        inputs = [told, self.fov, self.frame, models, self.held_out, cameras, self.depths]
        text = json.dumps(inputs, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def resume(self) -> bool:
        """Take over what an earlier run of the same inputs measured; whether there was any."""
        lines = self._journal()
        head = {"inputs": self.fingerprint()}
        if lines and lines[0] == head and self._take_over(lines[1:]):
            return bool(self.results)
        self.results.clear()
        (self.folder / JOURNAL).write_text(json.dumps(head) + "\n", encoding="utf-8")
        for stale in self.folder.glob("*.npz"):
            stale.unlink()
        return False

    def _take_over(self, entries: list[dict[str, Any]]) -> bool:
        """Fill in what was measured; False where that, or its pictures, are not as written."""
        try:
            for entry in entries:
                result = self.results[entry["point"], entry["repeat"]] = entry["result"]
                if "failed" not in result:
                    sum(result["seconds"].values(), sum(result[name] for name in COUNTED))
                arrays = self.folder / f"{entry['point']}.npz"
                if arrays.exists():
                    with np.load(arrays) as stored:
                        dict(stored)
        except DAMAGED:
            return False
        return True

    def _journal(self) -> list[dict[str, Any]]:
        """Its whole lines; a last one that was cut short is left out."""
        entries = []
        try:
            text = (self.folder / JOURNAL).read_text(encoding="utf-8")
        except FileNotFoundError:
            return []
        for line in text.splitlines():
            try:
                entries.append(json.loads(line))
            except ValueError:
                break
        return entries

    def left(self, points: Sequence[Point], repeats: int) -> list[tuple[Point, int]]:
        """What is still to be measured: all points once, then all again, and so on."""
        return [
            (point, repeat)
            for repeat in range(repeats)
            for point in points
            if (point.key, repeat) not in self.results
            and "failed" not in self.results.get((point.key, 0), {})
        ]

    def run(
        self, points: Sequence[Point], repeats: int, done: Callable[[], None] = lambda: None
    ) -> None:
        """Measure what is left, each time in a new process, and write each result down."""
        for point, repeat in self.left(points, repeats):
            if "failed" not in self.results.get((point.key, 0), {}):
                result = work(self.job(point, repeat))
                self.results[point.key, repeat] = result
                entry = {"point": point.key, "repeat": repeat, "result": result}
                with (self.folder / JOURNAL).open("a", encoding="utf-8") as journal:
                    journal.write(json.dumps(entry) + "\n")
            done()

    def job(self, point: Point, repeat: int) -> dict[str, Any]:
        """What a worker is told; pictures are made in the first repeat only."""
        return {
            "point": point.to_dict(),
            "photos": [str(path) for path in self.photos],
            "styles": [str(path) for path in self.styles],
            "fov": self.fov,
            "frame": self.frame,
            "model": self.models[point.precision],
            "held_out": self.held_out,
            "cameras": str(self.cameras) if self.cameras else None,
            "depths": self.depths,
            "pictures": str(self.arrays_of(point)) if repeat == 0 else None,
        }

    def arrays_of(self, point: Point) -> Path:
        """Where a point's Gaussians and pictures are kept."""
        return self.folder / f"{point.key}.npz"

    def repeats_of(self, point: Point) -> Iterator[dict[str, Any]]:
        """A point's results so far."""
        repeat = 0
        while (point.key, repeat) in self.results:
            yield self.results[point.key, repeat]
            repeat += 1


def work(job: dict[str, Any]) -> dict[str, Any]:
    """A job's result, from a process of its own; what it says when it dies is its result too."""
    command = [sys.executable, "-m", "styl3r_cli.tradeoff.worker"]
    ended = subprocess.run(command, input=json.dumps(job), capture_output=True, text=True)
    if ended.returncode != 0:
        if "KeyboardInterrupt" in ended.stderr:
            raise KeyboardInterrupt
        last = (ended.stderr.strip().splitlines() or [f"exit code {ended.returncode}"])[-1]
        return {"failed": last[:LAST_LINES]}
    return json.loads(ended.stdout)
