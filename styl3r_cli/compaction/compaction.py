"""A scene with only as many Gaussians as it requires, and the way to it for other colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.compaction.merging import merge
from styl3r_cli.compaction.survey import Survey
from styl3r_cli.compaction.tree import Cut, cut_tree
from styl3r_cli.fitting.refit import Target, refit, squared_errors
from styl3r_cli.fitting.tracing import Trace, look
from styl3r_cli.gaussians import FloatArray, Gaussians

# Steps of the colours' least squares: the fifth changes a picture by less than 0.1 dB.
REFIT_STEPS = 5
ROUGH_STEPS = 2  # where only the errors' places are wanted
DROPPED = -1
SQUARED_8BIT_STEP = 1e-12  # errors below (a millionth)^2 count as none: 120 dB


@dataclass(frozen=True)
class Compaction:
    """Which Gaussians became which, and how the result looks.

    Attributes:
        gaussians: the K that are left.
        labels: (G,) which of the K each Gaussian of the scene went into; DROPPED for none.
        weights: (G,) how much each counts in its group's colour.
        cameras: the witnesses.
        decibels: PSNR at each witness against the whole scene, mean over black and white behind.
    """

    gaussians: Gaussians
    labels: NDArray[np.int64]
    weights: FloatArray
    cameras: list[Camera]
    decibels: list[float]

    @property
    def worst(self) -> float:
        """PSNR at the witness that differs most."""
        return min(self.decibels)

    def apply(self, scene: Gaussians, threads: int | None = None) -> Compaction:
        """The same compaction of the same scene in other colours (another style of it).

        The geometry stays; colours are the groups' weighted means, then fitted to the frames of
        the scene in its new colours.

        Args:
            scene: the G Gaussians that were compacted, recoloured.
            threads: None for every core.

        Raises:
            ValueError: the scene has another number of Gaussians.
        """
        if len(scene) != len(self.labels):
            raise ValueError(f"{len(scene)} Gaussians, but {len(self.labels)} were compacted")
        kept = self.labels != DROPPED
        labels, weights = self.labels[kept], self.weights[kept]
        total = np.bincount(labels, weights, len(self.gaussians))
        colours = np.stack(
            [
                np.bincount(labels, weights * scene.colours[kept, k], len(total)) / total
                for k in range(3)
            ],
            axis=-1,
        )
        targets = [Target.of(each) for each in look(scene, self.cameras, threads)]
        start = self.gaussians.with_colours(colours.astype(np.float32))
        fitted, errors = fit(start, self.cameras, targets, REFIT_STEPS, threads)
        return replace(self, gaussians=fitted, decibels=decibels(errors))


@dataclass(frozen=True)
class Attempt:
    """One cut through a survey's tree, and what came of it."""

    cut: Cut
    gaussians: Gaussians
    corrections: NDArray[np.float64]
    decibels: list[float]

    @property
    def worst(self) -> float:
        """PSNR at the witness that differs most."""
        return min(self.decibels)


def attempt(
    known: Survey,
    count: int,
    above: Attempt | None = None,
    steps: int = REFIT_STEPS,
    threads: int | None = None,
) -> Attempt:
    """Merge the seen Gaussians into `count`, refit the colours, and measure.

    Args:
        known: the scene; it has a tree.
        count: how many to keep.
        above: a coarser attempt, whose measured errors say where this one splits.
        steps: of the colours' fit.
        threads: None for every core.
    """
    assert known.tree is not None
    before = (above.cut, above.corrections) if above else (None, None)
    cut = cut_tree(known.tree, count, *before)
    merged = merge(known.gaussians, known.weights, known.pixel_sizes, known.tree, cut, threads)
    traces = look(merged, known.cameras, threads)
    merged, errors = _fit(merged, traces, known.targets, steps, threads)
    measured = np.zeros(count if count < len(cut.nodes) else len(cut.nodes))
    for each, squared in zip(traces, errors, strict=True):
        measured += each.gather(squared).sum(axis=1)
    foretold = np.maximum(known.tree.errors[cut.nodes], SQUARED_8BIT_STEP)
    return Attempt(cut, merged, measured / foretold, decibels(errors))


def as_compaction(known: Survey, count: int, made: Attempt) -> Compaction:
    """An attempt as the result, for a scene of `count` Gaussians."""
    labels = np.full(count, DROPPED, np.int64)
    weights = np.zeros(count, np.float32)
    labels[known.seen], weights[known.seen] = made.cut.labels, known.weights
    return Compaction(made.gaussians, labels, weights, known.cameras, made.decibels)


def fit(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    targets: Sequence[Target],
    steps: int,
    threads: int | None,
) -> tuple[Gaussians, list[FloatArray]]:
    """Refit colours to frames; also the squared errors (P, 3) that are left in each."""
    return _fit(gaussians, look(gaussians, cameras, threads), targets, steps, threads)


def _fit(
    gaussians: Gaussians,
    traces: Sequence[Trace],
    targets: Sequence[Target],
    steps: int,
    threads: int | None,
) -> tuple[Gaussians, list[FloatArray]]:
    old = gaussians.colours
    colours = refit(traces, targets, old, steps, threads)
    errors = []
    for each, target in zip(traces, targets, strict=True):
        # What changed is drawn; the rest of the picture has shares too small for the matrix.
        picture = each.picture + each.draw(colours - old)
        errors.append(squared_errors(target, picture, each.through))
    return gaussians.with_colours(colours), errors


def decibels(errors: Sequence[FloatArray]) -> list[float]:
    """PSNR of each frame from its squared errors, for a peak of 1."""
    means = [max(float(squared.mean(dtype=np.float64)), SQUARED_8BIT_STEP) for squared in errors]
    return [-10 * math.log10(mean) for mean in means]
