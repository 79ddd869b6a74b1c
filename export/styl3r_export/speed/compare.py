"""Processes that take turns, so that a busy machine slows all of them alike, and their table."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from styl3r_cli.cameras.recover import recover
from styl3r_cli.errors import ModelError
from styl3r_cli.frames import Picture
from styl3r_cli.pipeline import Scene, assemble
from styl3r_cli.tradeoff.agreement import View, watch, worst

MEGABYTE = 1e6


class Worker:
    """A process that runs the network one way whenever it is asked to."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.load_seconds = self._answer()["load"]

    def run(self) -> dict[str, float]:
        """One pass over the photos and the style."""
        return self._ask("run")

    def save(self, path: Path) -> None:
        """Write the last pass's scene."""
        self._ask(str(path))

    def _ask(self, request: str) -> dict[str, Any]:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{request}\n")
        self._process.stdin.flush()
        return self._answer()

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise ModelError(f"a measured process ended with exit code {self._process.wait()}")
        answer: dict[str, Any] = json.loads(line)
        return answer


@contextmanager
def started(job: dict[str, Any]) -> Iterator[Worker]:
    """A worker that ends with the block."""
    command = [sys.executable, "-m", "styl3r_export.speed.worker", json.dumps(job)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            yield Worker(process)
        finally:
            process.kill()


@dataclass
class Timed:
    """One way to run the network: its passes, and the reference's that each of them followed."""

    name: str
    load_seconds: float
    passes: list[dict[str, float]] = field(default_factory=list)
    beside: list[dict[str, float]] = field(default_factory=list)

    def median(self, stage: str) -> float:
        """Median over passes of a stage's seconds, or of the memory."""
        return statistics.median(one[stage] for one in self.passes)

    def faster(self) -> float:
        """How many times faster than the reference, the median over neighbouring passes."""
        return statistics.median(
            total(theirs) / total(ours)
            for ours, theirs in zip(self.passes, self.beside, strict=True)
        )

    def less_work(self) -> float:
        """The same in processor time, which other programs on the machine do not add to."""
        return statistics.median(
            theirs["processor"] / ours["processor"]
            for ours, theirs in zip(self.passes, self.beside, strict=True)
        )


def total(one: dict[str, float]) -> float:
    """Seconds of one pass, both graphs."""
    return one["structure"] + one["appearance"]


def take_turns(name: str, worker: Worker, reference: Worker, repeats: int) -> Timed:
    """Warm a worker up, then let the reference and it run one after the other."""
    timed = Timed(name, worker.load_seconds)
    worker.run()
    for _ in range(repeats):
        timed.beside.append(reference.run())
        timed.passes.append(worker.run())
    return timed


def pictures(path: Path, cameras_of: Path, size: tuple[int, int]) -> list[Picture]:
    """A saved scene from a scene's cameras, and from between them."""
    with np.load(cameras_of) as archive:
        found = recover(archive["means"], archive["opacities"], archive["intrinsics"])
    with np.load(path) as archive:
        arrays = dict(archive)
    colours = arrays.pop("colours")
    gaussians, _ = assemble(Scene(**arrays), colours)
    return watch(gaussians, found.cameras, size, None)


def row(timed: Timed, reference: Timed, views: list[View], size: int) -> str:
    """One line of the table."""
    share = timed.median("memory") / reference.median("memory")
    decibels = f"{worst(views):6.1f} dB" if views else f"{'':9}"
    return (
        f"{timed.name[:20]:20}{timed.load_seconds:8.1f}{timed.median('structure'):11.2f}"
        f"{timed.median('appearance'):12.2f}{timed.faster():9.2f}{timed.less_work():9.2f}"
        f"{timed.median('memory') / MEGABYTE:9.0f} MB{share:7.0%}{decibels:>12}"
        f"{size / MEGABYTE:9.0f} MB"
    )


HEAD = (
    f"{'':20}{'load s':>8}{'structure s':>11}{'appearance s':>12}{'faster':>9}{'less CPU':>9}"
    f"{'memory':>12}{'share':>7}{'worst view':>12}{'on disk':>12}"
)
