"""The settings that are measured: dials, and the points that they are turned to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any

# How a frame is drawn: see `render`, its --antialias and its --quality.
DRAWINGS = ("exact", "antialias", "balanced", "draft")
# Colours fitted to the views, or as the network gives them: see `painter`.
COLOURS = ("fitted", "plain")
WHOLE = 100.0  # percent
AS_NEEDED = 0.0  # as many as `stylize` keeps of itself


@dataclass(frozen=True)
class Point:
    """One setting of all dials.

    Attributes:
        precision: of the graphs, as `styl3r export --precision` names it; GIVEN for the model as
            it is.
        size: side of the network's square pictures, pixels.
        views: how many photos, the first ones.
        budget: share of the Gaussians that is kept, in percent; or AS_NEEDED.
        drawing: one of DRAWINGS.
        threads: processor cores.
        colours: one of COLOURS.
    """

    precision: str
    size: int
    views: int
    budget: float
    drawing: str
    threads: int
    colours: str = COLOURS[0]

    @property
    def key(self) -> str:
        """A name that no other point has, and that a file may have."""
        views = f"{self.views}views"
        kept = f"{self.budget:g}pc"
        parts = (self.precision, self.size, views, kept, self.drawing, self.threads, self.colours)
        return "_".join(map(str, parts))

    def to_dict(self) -> dict[str, Any]:
        """The dials as plain values."""
        return asdict(self)


GIVEN = "given"


@dataclass(frozen=True)
class Dials:
    """What each dial is turned to; the first value of each is the reference's."""

    precision: Sequence[str]
    size: Sequence[int]
    views: Sequence[int]
    budget: Sequence[float]
    drawing: Sequence[str]
    threads: Sequence[int]
    colours: Sequence[str] = COLOURS

    @property
    def reference(self) -> Point:
        """What all others are compared with."""
        return Point(*(values[0] for values in self._values()))

    def points(self, grid: bool) -> list[Point]:
        """The reference, then each dial turned alone, or all combinations."""
        if grid:
            return [Point(*values) for values in product(*self._values())]
        turned = [
            replace(self.reference, **{name: value})
            for name, values in zip(Point.__dataclass_fields__, self._values(), strict=True)
            for value in values
        ]
        return list(dict.fromkeys([self.reference, *turned]))

    def _values(self) -> Sequence[Sequence[Any]]:
        return tuple(getattr(self, name) for name in Point.__dataclass_fields__)
