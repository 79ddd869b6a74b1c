"""Which frames of a video are given and which are drawn (spec section 11, "bounded")."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class Frames(NamedTuple):
    """Frames of a video: those given (first, any between, last) and those drawn."""

    inputs: list[int]
    targets: list[int]


@dataclass(frozen=True)
class GapSchedule:
    """Frames from the first input to the last: bounds that move linearly with training.

    Attributes:
        first: (least, most) at step 0.
        last: (least, most) from step `steps` on.
        steps: how long the bounds move.
    """

    first: tuple[int, int]
    last: tuple[int, int]
    steps: int = 9375

    def bounds(self, step: int) -> tuple[int, int]:
        """The least and the most frames at a step of training."""
        done = min(1.0, step / self.steps)
        least, most = (
            round(a + (b - a) * done) for a, b in zip(self.first, self.last, strict=True)
        )
        return least, most


@dataclass(frozen=True)
class DataSet:
    """What is particular to one data set.

    Attributes:
        gaps: how far the inputs are apart.
        frame_size: (width, height) that its frames have; videos with others are left out. None
            for any.
        widest: field of view in degrees, beyond which a video is left out.
    """

    gaps: GapSchedule
    frame_size: tuple[int, int] | None
    widest: float = 100.0


RE10K = DataSet(GapSchedule((25, 25), (45, 90)), (640, 360))
DL3DV = DataSet(GapSchedule((5, 7), (8, 22)), (480, 270))


def choose_frames(
    rng: np.random.Generator, length: int, bounds: tuple[int, int], inputs: int, targets: int
) -> Frames | None:
    """Frames of a video of `length`, or None where it is too short.

    The first and the last input are a random gap within the bounds apart; further inputs are
    distinct frames strictly between them, in random order; targets are drawn with replacement from
    the first input to the last, both included.
    """
    least, most = max(bounds[0], inputs - 1), min(bounds[1], length - 1)
    if most < least:
        return None
    gap = int(rng.integers(least, most + 1))
    first = int(rng.integers(length - gap))
    # (A gap of one has nothing between; no further input is then asked for.)
    between = first + 1 + rng.choice(max(gap - 1, 1), inputs - 2, replace=False)
    drawn = rng.integers(first, first + gap + 1, targets)
    return Frames([first, *map(int, between), first + gap], [int(k) for k in drawn])
