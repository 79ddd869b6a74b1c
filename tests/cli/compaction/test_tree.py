"""Trees and cuts: every Gaussian once, at any count; alike ones together."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from styl3r_cli.compaction.cuts import Splits
from styl3r_cli.compaction.tree import Tree, build_tree


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
    cut = Splits.of(tree).cut(wanted)
    assert len(cut.nodes) == min(wanted, count)
    assert sorted(np.unique(cut.labels)) == list(range(len(cut.nodes)))
    for place, node in enumerate(cut.nodes):
        members = tree.order[tree.starts[node] : tree.ends[node]]
        assert (cut.labels[members] == place).all()


def test_a_finer_cut_refines_a_coarser_one() -> None:
    tree = random_tree(500, 1)
    coarse = Splits.of(tree).cut(40)
    corrections = np.random.default_rng(2).uniform(0, 100, 40)
    fine = Splits.of(tree, coarse, corrections).cut(120)
    assert len(fine.nodes) == 120
    parents = {}
    for child, parent in zip(fine.labels, coarse.labels, strict=True):
        assert parents.setdefault(child, parent) == parent


def test_corrections_say_where_to_split() -> None:
    tree = random_tree(500, 1)
    coarse = Splits.of(tree).cut(10)
    corrections = np.full(10, 1e-6)
    corrections[3] = 1.0
    fine = Splits.of(tree, coarse, corrections).cut(20)
    inside = len(np.unique(fine.labels[coarse.labels == 3]))
    assert inside == 11


def test_colours_divide_before_places_do() -> None:
    random = np.random.default_rng(0)
    places = random.random((200, 3)) * 0.02  # two pixels
    red = random.random(200) < 0.5
    colours = np.where(red[:, None], [1.0, 0, 0], [0, 0, 1.0])
    cut = Splits.of(build_tree(places, colours, np.ones(200), np.full(200, 0.01))).cut(2)
    assert (cut.labels[red] == cut.labels[red][0]).all()
    assert (cut.labels[~red] == cut.labels[~red][0]).all()


def test_the_root_costs_what_its_colours_differ() -> None:
    colours = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 0, 0]])
    tree = build_tree(np.zeros((3, 3)), colours, np.array([1.0, 1, 2]), np.ones(3))
    assert tree.errors[0] == pytest.approx(1 * 0.75**2 + 3 * 0.25**2)


def test_errors_say_how_many_it_takes() -> None:
    tree = random_tree(300, 3)
    splits = Splits.of(tree)
    for error in (0.5, 0.1, 0.01):
        wanted = error * tree.errors[0]
        count = splits.count_for(wanted)
        assert tree.errors[splits.cut(count).nodes].sum() <= wanted * (1 + 1e-9)
        assert tree.errors[splits.cut(count - 1).nodes].sum() > wanted
    above = splits.cut(40)
    corrections = np.full(40, 2.0)
    finer = Splits.of(tree, above, corrections)
    left = tree.errors[above.nodes].sum()
    assert finer.count_for(2 * left) == 40
    assert finer.count_for(left) > 40


def test_the_same_tree_from_any_number_of_threads() -> None:
    random = np.random.default_rng(5)
    places, colours = random.random((900, 3)), random.random((900, 3))
    weights, sizes = random.uniform(0.1, 2, 900), np.full(900, 0.01)
    one, three = (build_tree(places, colours, weights, sizes, np.zeros(3), None, n) for n in (1, 3))
    for name in ("order", "starts", "ends", "parents", "leaves", "errors"):
        assert (getattr(one, name) == getattr(three, name)).all()


def test_what_lies_behind_is_split_off_before_what_lies_beside() -> None:
    """A strip a little longer across than deep: seen from afar along z, it is halved in depth."""
    x, z = np.meshgrid(np.arange(12) * 0.01, np.arange(8) * 0.01)
    means = np.stack((x.ravel(), np.zeros(x.size), 10 + z.ravel()), -1)
    alike = np.ones(len(means))
    colours, sizes = np.full(means.shape, 0.5), np.full(len(means), 0.01)
    for eye, axis in ((None, 0), (np.zeros(3), 2)):
        tree = build_tree(means, colours, alike, sizes, eye)
        halves = [means[tree.order[tree.starts[node] : tree.ends[node]], axis] for node in (1, 2)]
        low, high = sorted(halves, key=np.mean)
        assert low.max() < high.min()
