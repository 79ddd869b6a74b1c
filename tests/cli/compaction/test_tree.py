"""Trees and cuts: every Gaussian once, at any count; alike ones together."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from styl3r_cli.compaction.tree import Tree, build_tree, cut_tree


def random_tree(count: int, seed: int, distinct: bool = True) -> Tree:
    random = np.random.default_rng(seed)
    places = random.random((count, 3)) if distinct else np.ones((count, 3))
    colours = random.random((count, 3)) if distinct else np.ones((count, 3))
    return build_tree(places, colours, random.uniform(0.1, 2, count), np.full(count, 0.01))


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 60), st.integers(1, 70), st.integers(0, 5), st.booleans())
def test_a_cut_holds_every_gaussian_once(
    count: int, wanted: int, seed: int, distinct: bool
) -> None:
    tree = random_tree(count, seed, distinct)
    cut = cut_tree(tree, wanted)
    assert len(cut.nodes) == min(wanted, count)
    assert sorted(np.unique(cut.labels)) == list(range(len(cut.nodes)))
    for place, node in enumerate(cut.nodes):
        members = tree.order[tree.starts[node] : tree.ends[node]]
        assert (cut.labels[members] == place).all()


def test_a_finer_cut_refines_a_coarser_one() -> None:
    tree = random_tree(500, 1)
    coarse = cut_tree(tree, 40)
    corrections = np.random.default_rng(2).uniform(0, 100, 40)
    fine = cut_tree(tree, 120, coarse, corrections)
    assert len(fine.nodes) == 120
    parents = {}
    for child, parent in zip(fine.labels, coarse.labels, strict=True):
        assert parents.setdefault(child, parent) == parent


def test_corrections_say_where_to_split() -> None:
    tree = random_tree(500, 1)
    coarse = cut_tree(tree, 10)
    corrections = np.full(10, 1e-6)
    corrections[3] = 1.0
    fine = cut_tree(tree, 20, coarse, corrections)
    inside = len(np.unique(fine.labels[coarse.labels == 3]))
    assert inside == 11


def test_colours_divide_before_places_do() -> None:
    random = np.random.default_rng(0)
    places = random.random((200, 3)) * 0.02  # two pixels
    red = random.random(200) < 0.5
    colours = np.where(red[:, None], [1.0, 0, 0], [0, 0, 1.0])
    cut = cut_tree(build_tree(places, colours, np.ones(200), np.full(200, 0.01)), 2)
    assert (cut.labels[red] == cut.labels[red][0]).all()
    assert (cut.labels[~red] == cut.labels[~red][0]).all()


def test_the_root_costs_what_its_colours_differ() -> None:
    colours = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 0, 0]])
    tree = build_tree(np.zeros((3, 3)), colours, np.array([1.0, 1, 2]), np.ones(3))
    assert tree.errors[0] == pytest.approx(1 * 0.75**2 + 3 * 0.25**2)
