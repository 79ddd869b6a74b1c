"""All points, repeated and interleaved, with a journal that an interrupted run goes on from."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from styl3r_cli.errors import OutputError
from styl3r_cli.tradeoff.journal import Journal, digest_of
from styl3r_cli.tradeoff.points import Point

JOURNAL = "measured.jsonl"
# In a result: what kept a worker from writing its pictures; and whether a failure may be the
# machine's (memory, a signal), so that a run that goes on tries again.
UNWRITABLE, AGAIN = "unwritable", "again"
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
        told = [(str(path.resolve()), digest_of(path)) for path in files]
        models = {
            name: hashlib.sha256((Path(folder) / "manifest.json").read_bytes()).hexdigest()
            for name, folder in self.models.items()
        }
        cameras = self.cameras and hashlib.sha256(self.cameras.read_bytes()).hexdigest()
        inputs = [told, self.fov, self.frame, models, self.held_out, cameras, self.depths]
        text = json.dumps(inputs, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def resume(self) -> bool:
        """Take over what an earlier run of the same inputs measured; whether there was any.

        Raises:
            OutputError: the folder cannot be written.
        """
        head = {"inputs": self.fingerprint()}
        entries = self._journal.read()
        kept = [entry for entry in entries[1:] if self._is_there(entry)]
        if entries[:1] != [head]:
            kept = []
            for stale in self.folder.glob("*.npz"):
                with suppress(OSError):  # nothing but room is lost
                    stale.unlink()
        self.results = {(entry["point"], entry["repeat"]): entry["result"] for entry in kept}
        self._journal.write([head, *kept])
        return bool(kept)

    @property
    def _journal(self) -> Journal:
        return Journal(self.folder / JOURNAL)

    def _is_there(self, entry: dict[str, Any]) -> bool:
        """Whether the pictures that were made with a measurement are as they were."""
        if entry["arrays"] is None:
            return True
        return digest_of(self.folder / f"{entry['point']}.npz") == entry["arrays"]

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
        """Measure what is left, each time in a new process, and write each result down.

        Raises:
            OutputError: a result cannot be written.
        """
        for point, repeat in self.left(points, repeats):
            if "failed" not in self.results.get((point.key, 0), {}):
                result = work(self.job(point, repeat))
                self.results[point.key, repeat] = result
                if not result.get(AGAIN):
                    made = repeat == 0 and "failed" not in result
                    arrays = digest_of(self.arrays_of(point)) if made else None
                    entry = {"point": point.key, "repeat": repeat, "result": result}
                    self._journal.add(entry | {"arrays": arrays})
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
    """A job's result, from a process of its own; what it says when it dies is its result too.

    Raises:
        OutputError: it could not write its pictures.
    """
    command = [sys.executable, "-m", "styl3r_cli.tradeoff.worker"]
    ended = subprocess.run(command, input=json.dumps(job), capture_output=True, text=True)
    if ended.returncode != 0:
        if "KeyboardInterrupt" in ended.stderr:
            raise KeyboardInterrupt
        last = (ended.stderr.strip().splitlines() or [f"exit code {ended.returncode}"])[-1]
        return {"failed": last[:LAST_LINES], AGAIN: True}
    result: dict[str, Any] = json.loads(ended.stdout)
    if UNWRITABLE in result:
        raise OutputError(result[UNWRITABLE])
    return result
