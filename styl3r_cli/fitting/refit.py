"""Colours in which merged Gaussians look most like the scene that they stand for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.fitting.tracing import Trace
from styl3r_cli.gaussians import FloatArray
from styl3r_cli.threads import in_threads

# How much a colour is held to the one it had, beside what the frames say of it: little, for
# Gaussians of which the frames show next to nothing.
HOLD, LEAST_HOLD = 0.02, 1e-3
# What the frames are drawn on: neither black nor white, so that gaps are not painted over with
# colours that are right on one background only.
GREY = np.float32(0.5)
_ALIKE = np.float32(1)  # weight of every pixel, where none counts for more


@dataclass(frozen=True)
class Target:
    """How a frame should look.

    Attributes:
        picture: (P, 3) on black.
        through: (P,) transmittance.
        weight: (P, 1), or one for all: how much a pixel's squared error counts.
    """

    picture: FloatArray
    through: FloatArray
    weight: FloatArray | np.float32 = _ALIKE

    @classmethod
    def of(cls, seen: Trace) -> Target:
        """As a traced scene does."""
        return cls(seen.picture, seen.through)

    def missing(self, picture: FloatArray, through: FloatArray) -> FloatArray:
        """(P, 3) what a frame lacks, both on grey."""
        lacking = GREY * (self.through - through)
        return self.picture - picture + lacking[:, None]


def squared_errors(target: Target, picture: FloatArray, through: FloatArray) -> FloatArray:
    """(P, 3) squared differences of two frames, the mean of those on black and on white.

    On grey they differ by d, on black and white by d -+ t / 2 (t: difference in transmittance);
    the mean of both squares is d^2 + t^2 / 4.
    """
    veil = (GREY * (target.through - through)) ** 2
    return target.missing(picture, through) ** 2 + veil[:, None]


def refit(
    traces: Sequence[Trace],
    targets: Sequence[Target],
    colours: FloatArray,
    steps: int,
    threads: int | None = None,
) -> FloatArray:
    """Linear least squares over all pixels of all frames, from given colours.

    A few steps of conjugate gradients, preconditioned by the diagonal (Shewchuk 1994, B3); the
    matrices are the traces'. Colours stay within [0, 1], or within what they were.

    Args:
        traces: of the merged Gaussians, a frame each.
        targets: what the frames should look like.
        colours: (K, 3) to start from.
        steps: of the iteration.
        threads: None for every core.

    Returns:
        (K, 3) sRGB.
    """
    if steps < 1:
        return colours

    def each(work: Callable[[int], FloatArray]) -> FloatArray:
        return np.sum(in_threads(work, range(len(traces)), threads), axis=0)

    def weighed(n: int, values: FloatArray) -> FloatArray:
        """(P, 3) values of a frame's pixels, back to its Gaussians."""
        return traces[n].gather(targets[n].weight * values)

    def normal(values: FloatArray) -> FloatArray:
        return each(lambda n: weighed(n, traces[n].draw(values))) + hold * values

    shown = each(lambda n: weighed(n, np.ones_like(traces[n].picture)))[:, :1]
    hold = HOLD * shown + np.float32(LEAST_HOLD)
    residual = each(lambda n: weighed(n, targets[n].missing(traces[n].picture, traces[n].through)))
    best = _conjugate_gradients(normal, np.float32(1) / (shown + hold), residual, steps)
    brightest = np.maximum(np.float32(1), colours.max(initial=0))
    return np.clip(colours + best, min(0, colours.min(initial=0)), brightest).astype(np.float32)


def _conjugate_gradients(
    normal: Callable[[FloatArray], FloatArray],
    preconditioner: NDArray[np.floating],
    residual: FloatArray,
    steps: int,
) -> FloatArray:
    """Solve normal(x) = residual for each column on its own."""
    solution = np.zeros_like(residual)
    scaled = preconditioner * residual
    direction = scaled.copy()
    before = (residual * scaled).sum(axis=0, dtype=np.float64)
    for _ in range(steps):
        product = normal(direction)
        curvature = (direction * product).sum(axis=0, dtype=np.float64)
        length = np.divide(before, curvature, out=np.zeros(3), where=curvature > 0)
        solution += length.astype(np.float32) * direction
        residual = residual - length.astype(np.float32) * product
        scaled = preconditioner * residual
        after = (residual * scaled).sum(axis=0, dtype=np.float64)
        turn = np.divide(after, before, out=np.zeros(3), where=before > 0)
        direction = scaled + turn.astype(np.float32) * direction
        before = after
    return solution
