"""How many Gaussians to try next, by what was foretold and what earlier attempts measured."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from styl3r_cli.compaction.attempts import Attempt
from styl3r_cli.compaction.cuts import Splits
from styl3r_cli.compaction.tree import Tree
from styl3r_cli.fitting.refit import Target

# Errors shrink a little more slowly than foretold; and what is aimed at above what was asked for
# makes most second attempts the last.
OPTIMISM, MARGIN = 1.1, 0.5
LEAST_STEP, LARGEST_STEP = 1.01, 3.0
LEAST_SLOPE = 2.0  # decibels per doubling: what two attempts that hardly differ are taken for
# Decibels per doubling at 35 and at 45: the last Gaussians that are merged matter most. Measured on
# real scenes, 8 to 11 and 10 to 30.
SLOPES = ((35.0, 45.0), (9.0, 20.0))


def foretold(tree: Tree, targets: Sequence[Target], decibels: float) -> int:
    """How many show the targets to so many decibels, as the tree has it."""
    values = sum(each.picture.size for each in targets)
    return Splits.of(tree).count_for(values * 10 ** (-0.1 * decibels))


def more(tree: Tree, rough: Attempt, target: float) -> int:
    """How many should do, by the errors of a rough attempt."""
    lacking = OPTIMISM * (target - rough.worst) + MARGIN
    error = float(rough.errors.sum()) * 10 ** (-0.1 * lacking)
    return _step(rough, rough.splits(tree).count_for(error))


def better(failed: Sequence[Attempt], done: Attempt | None, target: float) -> int:
    """How many to try after attempts that did not do, or after one that did far too well."""
    if done is not None and failed:
        return _between(failed[-1], done, target)
    if len(failed) > 1:
        return _between(failed[-2], failed[-1], target)
    one = failed[0] if done is None else done
    doublings = (target + MARGIN - one.worst) / float(np.interp(target, *SLOPES))
    if done is not None:
        return max(1, math.ceil(len(one.gaussians) * 2**doublings))
    return _step(one, len(one.gaussians) * 2**doublings)


def _between(one: Attempt, two: Attempt, target: float) -> int:
    """Where decibels over the logarithm of the count, a line through two attempts, meet a target.

    The line goes on beyond the second.
    """
    few, many = len(one.gaussians), len(two.gaussians)
    slope = max((two.worst - one.worst) / math.log2(many / few), LEAST_SLOPE)
    nearer = two if two.worst < target else one
    lacking = target + MARGIN - nearer.worst
    return _step(nearer, len(nearer.gaussians) * 2 ** (lacking / slope))


def _step(failed: Attempt, count: float) -> int:
    """A count within reach of a failed attempt's."""
    few = len(failed.gaussians)
    return math.ceil(min(max(count, LEAST_STEP * few), LARGEST_STEP * few)) + 1
