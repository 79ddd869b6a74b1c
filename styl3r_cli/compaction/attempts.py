"""One way to have fewer Gaussians, tried out: merged, coloured, drawn and measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.compaction.compaction import SQUARED_8BIT_STEP, decibels
from styl3r_cli.compaction.cuts import Cut, Splits
from styl3r_cli.compaction.merging import merge
from styl3r_cli.compaction.survey import Survey, pixel_sizes
from styl3r_cli.compaction.tree import Tree
from styl3r_cli.fitting.refit import Target, refit, squared_errors
from styl3r_cli.fitting.reshape import reshape
from styl3r_cli.fitting.tracing import Trace, look
from styl3r_cli.gaussians import FloatArray, Gaussians
from styl3r_cli.threads import in_threads

# Conjugate gradients of a step of shapes: 3 of them gain 0.6 dB less, 12 gain 0.1 dB more.
RESHAPE_STEPS = 6


@dataclass(frozen=True)
class Merged:
    """The nodes of a cut as Gaussians, and what the witnesses see of them."""

    cut: Cut
    gaussians: Gaussians
    traces: list[Trace]


@dataclass(frozen=True)
class Attempt:
    """What came of a cut through a survey's tree.

    Attributes:
        cut: the cut.
        gaussians: its nodes, in the colours that look most like the scene.
        traces: what the witnesses see of them.
        errors: (K,) the squared errors that are left of each one's pixels, those of worse frames
            counted more.
        decibels: PSNR at each witness.
    """

    cut: Cut
    gaussians: Gaussians
    traces: list[Trace]
    errors: NDArray[np.float64]
    decibels: list[float]

    @property
    def worst(self) -> float:
        """PSNR at the witness that differs most."""
        return min(self.decibels)

    def splits(self, tree: Tree) -> Splits:
        """What refines its cut: split first where more errors were measured than foretold."""
        foretold = np.maximum(tree.errors[self.cut.nodes], SQUARED_8BIT_STEP)
        return Splits.of(tree, self.cut, self.errors / foretold)


def merge_cut(known: Survey, cut: Cut, threads: int | None) -> Merged:
    """Merge each node of a cut, and look at the result; colours are the scene's plain ones."""
    assert known.tree is not None
    merged = merge(known.gaussians, known.weights, known.pixel_sizes, known.tree, cut, threads)
    return Merged(cut, merged, look(merged, known.cameras, threads))


def attempt(
    known: Survey,
    merged: Merged,
    colours: FloatArray,
    targets: Sequence[Target],
    steps: int,
    threads: int | None,
) -> Attempt:
    """Give merged Gaussians a scene's colours, and measure.

    Args:
        known: the scene.
        merged: of it.
        colours: (S, 3) of what is seen of it; to begin with, each node has the mean of its own.
        targets: what the witnesses see of the whole scene in these colours.
        steps: of the colours' fit.
        threads: None for every core.
    """
    plain, labels = merged.gaussians.colours, merged.cut.labels
    start, traces = plain, merged.traces
    if colours is not known.gaussians.colours:
        start = node_means(colours, labels, known.weights, len(plain))
        traces = [each.recoloured(start - plain) for each in traces]
    fitted = refit(traces, targets, start, steps, threads)
    traces = [each.recoloured(fitted - start) for each in traces]
    return _measured(merged.cut, merged.gaussians.with_colours(fitted), traces, targets, threads)


def reshaped(
    known: Survey, made: Attempt, targets: Sequence[Target], threads: int | None
) -> Attempt:
    """Change an attempt's shapes so that they look more like the scene, and measure.

    The attempt loses its traces on the way: both attempts' would take gigabytes of large scenes.
    """
    sizes = pixel_sizes(made.gaussians, known.cameras)
    gaussians = reshape(made.gaussians, made.traces, targets, sizes, RESHAPE_STEPS, threads)
    made.traces.clear()
    traces = look(gaussians, known.cameras, threads)
    return _measured(made.cut, gaussians, traces, targets, threads)


def _measured(
    cut: Cut,
    gaussians: Gaussians,
    traces: list[Trace],
    targets: Sequence[Target],
    threads: int | None,
) -> Attempt:
    """Compare with the targets what the witnesses see."""
    squares = [
        squared_errors(target, each.picture, each.through)
        for target, each in zip(targets, traces, strict=True)
    ]
    measured = decibels(squares)
    mean = float(np.mean(measured))
    # The promise is made for the worst frame: what is wrong in it counts for more.
    urgencies = [10 ** (0.1 * (mean - shown)) for shown in measured]

    def errors(n: int) -> NDArray[np.float64]:
        return urgencies[n] * traces[n].gather(squares[n]).sum(axis=1, dtype=np.float64)

    total = np.sum(in_threads(errors, range(len(traces)), threads), axis=0)
    return Attempt(cut, gaussians, traces, total, measured)


def node_means(
    colours: FloatArray, labels: NDArray[np.int64], weights: NDArray[np.float64], count: int
) -> FloatArray:
    """(K, 3) weighted means of the (S, 3) colours of each label."""
    total = np.bincount(labels, weights, count)
    sums = [np.bincount(labels, weights * column, count) for column in colours.T]
    return (np.stack(sums, -1) / total[:, None]).astype(np.float32)
