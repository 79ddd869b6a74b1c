"""Cuts through a tree of Gaussians: how many nodes, and which, for how much error."""

# numba infers the types of the kernels.
# mypy: allow-untyped-defs

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.compaction.tree import Tree
from styl3r_cli.splatting.compiler import kernel


@dataclass(frozen=True)
class Cut:
    """Nodes that hold every Gaussian once.

    Attributes:
        nodes: (K,) indices.
        labels: (G,) which of them each Gaussian is in.
        split: (N,) the nodes above.
    """

    nodes: NDArray[np.int64]
    labels: NDArray[np.int64]
    split: NDArray[np.bool_]


@dataclass(frozen=True)
class Splits:
    """The order in which a tree's nodes are split.

    Attributes:
        tree: whose nodes.
        order: (G - 1,) its nodes of several Gaussians; those with the largest errors first.
        errors: (N,) of all nodes, corrected.
        fewest: nodes of the cut that this one refines.
    """

    tree: Tree
    order: NDArray[np.intp]
    errors: NDArray[np.float64]
    fewest: int

    @classmethod
    def of(
        cls,
        tree: Tree,
        above: Cut | None = None,
        corrections: NDArray[np.float64] | None = None,
    ) -> Splits:
        """Rank the nodes.

        Args:
            tree: to cut.
            above: a cut that is to be refined: what is split there is split first.
            corrections: what the errors of the nodes of `above`, and of all below them, are to be
                multiplied by (what was measured over what the tree foretold).
        """
        factors = np.full(len(tree.errors), -1.0)
        forced = np.zeros(len(tree.errors), np.bool_)
        if above is not None:
            forced = above.split
            factors[above.nodes] = 1.0 if corrections is None else corrections
        ranks, errors = np.empty(len(tree.errors)), np.empty(len(tree.errors))
        _rank(tree.errors, tree.parents, factors, forced, ranks, errors)
        several = np.flatnonzero(~tree.leaves)
        # Equal ranks by index: a parent before its children.
        order = several[np.argsort(-ranks[several], kind="stable")]
        return cls(tree, order, errors, 1 if above is None else len(above.nodes))

    def cut(self, count: int) -> Cut:
        """As many nodes (at most one a Gaussian, at least one)."""
        tree = self.tree
        split = np.zeros(len(tree.errors), np.bool_)
        split[self.order[: max(count - 1, 0)]] = True
        nodes = np.flatnonzero(~split & ((tree.parents < 0) | split[tree.parents]))
        nodes = nodes[np.argsort(tree.starts[nodes])]
        labels = np.empty(len(tree.order), np.int64)
        sizes = (tree.ends - tree.starts)[nodes]
        labels[tree.order] = np.repeat(np.arange(len(nodes)), sizes)
        return Cut(nodes, labels, split)

    def count_for(self, error: float) -> int:
        """How many nodes it takes until their errors sum up to no more than that."""
        parents = self.tree.parents[1:]
        below = np.bincount(parents, self.errors[1:], len(self.errors))
        left = self.errors[0] - np.cumsum((self.errors - below)[self.order])
        enough = np.flatnonzero(left <= error)
        count = int(enough[0]) + 2 if len(enough) else len(self.tree.order)
        return max(count, self.fewest)


@kernel
def _rank(errors, parents, factors, forced, ranks, corrected):
    """Errors after correction; ranks are infinite where forced, and none is above its parent's."""
    factor = np.ones(len(errors))
    for i in range(len(errors)):
        up = parents[i]
        if up >= 0:
            factor[i] = factor[up]
        if factors[i] >= 0:
            factor[i] = factors[i]
        corrected[i] = errors[i] * factor[i]
        ranks[i] = math.inf if forced[i] else corrected[i]
        if up >= 0:
            ranks[i] = min(ranks[i], ranks[up])
