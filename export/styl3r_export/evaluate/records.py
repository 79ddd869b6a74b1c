"""Measured numbers, and what they come to: medians, quartiles, areas under recall."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from styl3r_export.evaluate.groups import Group

MODEL = "model"  # the method that is evaluated; all others are baselines

# (what, measure, method) to the group's numbers, one or several.
Values = dict[tuple[str, str, str], list[float]]


@dataclass(frozen=True)
class Record:
    """All numbers of one group of photos.

    Attributes:
        kind: "validation", or "training" where training may have seen the scene; "generated",
            "RE10K" and "COLMAP" for what comes from there.
        scene: its name.
        inputs: names of the photos given.
        targets: names of the photos to be drawn, if any.
        values: by what, measure and method.
    """

    kind: str
    scene: str
    inputs: list[str]
    targets: list[str]
    values: Values

    @classmethod
    def of(cls, kind: str, group: Group, values: Values) -> Record:
        """The record of a group."""
        names = [view.name for view in group.scene.views]
        inputs, targets = ([names[k] for k in chosen] for chosen in (group.inputs, group.targets))
        return cls(kind, group.scene.name, inputs, targets, values)

    def to_dict(self) -> dict[str, Any]:
        """For JSON: the values as a list of objects."""
        values = [
            {"what": what, "measure": measure, "method": method, "values": numbers}
            for (what, measure, method), numbers in self.values.items()
        ]
        return asdict(self) | {"values": values}


@dataclass(frozen=True)
class Summary:
    """One measure of one method over many groups.

    Attributes:
        kind: of the scenes.
        views: photos given.
        what: "depth", "cameras", ...
        measure: its name.
        method: "model", or the baseline's name.
        median: over all numbers of all groups.
        quartiles: the first and the third.
        mean: the average.
        count: how many numbers.
        scenes: how many scenes they are from.
    """

    kind: str
    views: int
    what: str
    measure: str
    method: str
    median: float
    quartiles: tuple[float, float]
    mean: float
    count: int
    scenes: int

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def pooled(records: Iterable[Record]) -> dict[tuple[str, str, str], list[tuple[str, float]]]:
    """All numbers by what, measure and method, each with its scene, in order of appearance."""
    pools: dict[tuple[str, str, str], list[tuple[str, float]]] = {}
    for record in records:
        for key, numbers in record.values.items():
            pools.setdefault(key, []).extend((record.scene, number) for number in numbers)
    return pools


def summarise(records: Iterable[Record], kind: str, views: int) -> list[Summary]:
    """What the groups of one kind and size come to."""
    chosen = [r for r in records if r.kind == kind and len(r.inputs) == views]
    summaries = []
    for key, numbers in pooled(chosen).items():
        values = np.array([number for _, number in numbers])
        low, median, high = (float(q) for q in np.percentile(values, [25, 50, 75]))
        scenes = len({scene for scene, _ in numbers})
        average = float(values.mean())
        summaries.append(
            Summary(kind, views, *key, median, (low, high), average, len(values), scenes)
        )
    return summaries
