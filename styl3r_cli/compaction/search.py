"""How many Gaussians a promise takes: so many decibels, or so many at most."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.compaction.compaction import (
    DROPPED,
    REFIT_STEPS,
    ROUGH_STEPS,
    Attempt,
    Compaction,
    as_compaction,
    attempt,
    decibels,
)
from styl3r_cli.compaction.survey import Survey, survey
from styl3r_cli.fitting.refit import squared_errors
from styl3r_cli.fitting.tracing import look
from styl3r_cli.gaussians import Gaussians

# A budget is reached by way of coarser cuts, whose measured errors say where to split: with none
# on the way it is 3 dB worse, with two 0.4 dB better than with one.
STAGES = (0.6, 1.0)
# The search for decibels: where it begins, and how it goes on where two points are not known yet.
FIRST_SHARE, DECIBELS_PER_DOUBLING = 0.12, 8.0
LEAST_STEP, LARGEST_STEP = 1.04, 2.5
MARGIN = 0.25  # decibels that are aimed at above what was asked for: one attempt less, on average
WASTE = 0.8  # decibels too many are worth one more attempt
FINE = 0.97  # a share of what is known to do that is no longer worth an attempt
MOST_ATTEMPTS = 8


def keep_count(
    scene: Gaussians, cameras: Sequence[Camera], count: int, threads: int | None = None
) -> Compaction:
    """At most `count` Gaussians, so that the witnesses see as little difference as possible.

    Args:
        scene: the Gaussians.
        cameras: the witnesses.
        count: at least 1.
        threads: None for every core.
    """
    known = survey(scene, cameras, threads)
    if count >= len(known.seen):
        return _without_unseen(scene, known, threads)
    made: Attempt | None = None
    for stage in STAGES:
        steps = REFIT_STEPS if stage == STAGES[-1] else ROUGH_STEPS
        made = attempt(known, max(1, round(stage * count)), made, steps, threads)
    assert made is not None
    return as_compaction(known, len(scene), made)


def keep_decibels(
    scene: Gaussians, cameras: Sequence[Camera], target: float, threads: int | None = None
) -> Compaction:
    """As few Gaussians as keep every witness's frame within `target` decibels (PSNR).

    Measured: each attempt is drawn. From a coarse cut the search grows along the line through its
    last two points, then goes back once between them if it went too far.

    Args:
        scene: the Gaussians.
        cameras: the witnesses.
        target: PSNR against the whole scene, at the witness that differs most.
        threads: None for every core.
    """
    known = survey(scene, cameras, threads)
    most = len(known.seen)
    failed: Attempt | None = None
    done: Attempt | None = None
    count, slope = max(1, round(FIRST_SHARE * len(scene))), DECIBELS_PER_DOUBLING
    for _ in range(MOST_ATTEMPTS):
        if count >= most:
            break
        made = attempt(known, count, failed, REFIT_STEPS, threads)
        if made.worst >= target:
            done = made
            if failed is None or made.worst - target < WASTE:
                break
        else:
            slope = _slope(failed, made, slope)
            failed = made
        step = _step(target, slope, failed, done)
        count = math.ceil(len(failed.gaussians) * step)
        if done is not None and count >= FINE * len(done.gaussians):
            break
    if done is not None:
        return as_compaction(known, len(scene), done)
    result = _without_unseen(scene, known, threads)
    return result if result.worst >= target else everything(scene, cameras)


def everything(scene: Gaussians, cameras: Sequence[Camera]) -> Compaction:
    """The scene as it is."""
    count = len(scene)
    nothing_lost = [math.inf] * len(cameras)
    return Compaction(
        scene, np.arange(count), np.ones(count, np.float32), list(cameras), nothing_lost
    )


def _slope(before: Attempt | None, now: Attempt, otherwise: float) -> float:
    """Decibels per doubling between two attempts."""
    if before is None:
        return otherwise
    doublings = math.log2(len(now.gaussians) / len(before.gaussians))
    return max((now.worst - before.worst) / max(doublings, 1e-3), 1.0)


def _step(target: float, slope: float, failed: Attempt, done: Attempt | None) -> float:
    """By what to multiply the last failed count, so that the line meets the target."""
    if done is not None:
        slope = _slope(failed, done, slope)
    step = 2 ** ((target + MARGIN - failed.worst) / slope)
    return min(max(step, LEAST_STEP), LARGEST_STEP)


def _without_unseen(scene: Gaussians, known: Survey, threads: int | None) -> Compaction:
    """Only what no witness sees is left out, and the rest is as it was."""
    labels = np.full(len(scene), DROPPED, np.int64)
    labels[known.seen] = np.arange(len(known.seen))
    traces = look(known.gaussians, known.cameras, threads)
    errors = [
        squared_errors(target, each.picture, each.through)
        for target, each in zip(known.targets, traces, strict=True)
    ]
    weights = np.ones(len(scene), np.float32)
    return Compaction(known.gaussians, labels, weights, known.cameras, decibels(errors))
