"""Merging: moments against numpy, rotations against matrices, and members left alone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from styl3r_cli.compaction.cuts import Splits
from styl3r_cli.compaction.merging import merge
from styl3r_cli.compaction.tree import build_tree
from styl3r_cli.gaussians import Gaussians


def some(count: int, seed: int = 0) -> Gaussians:
    random = np.random.default_rng(seed)
    return Gaussians(
        random.normal(size=(count, 3)),
        random.uniform(0.1, 1, (count, 3)),
        random.normal(size=(count, 4)),
        random.uniform(0.1, 0.4, count),
        random.random((count, 3)),
    )


def covariances(gaussians: Gaussians) -> NDArray[np.float64]:
    w, x, y, z = (gaussians.rotations / np.linalg.norm(gaussians.rotations, axis=1)[:, None]).T
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    half = turn * gaussians.scales[:, None, :]
    return half @ half.transpose(0, 2, 1)


@pytest.mark.parametrize("seed", range(6))
def test_moments_are_kept(seed: int) -> None:
    scene, weights = some(7, seed), np.random.default_rng(seed).uniform(0.5, 2, 7)
    tree = build_tree(scene.means, scene.colours, weights, np.full(7, 0.01))
    one = merge(scene, weights, np.full(7, 0.01), tree, Splits.of(tree).cut(1), widening=0.0)
    mean = np.average(scene.means, axis=0, weights=weights)
    apart = scene.means - mean
    wanted = np.average(
        covariances(scene) + apart[:, :, None] * apart[:, None, :], axis=0, weights=weights
    )
    np.testing.assert_allclose(one.means[0], mean, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(
        one.colours[0], np.average(scene.colours, axis=0, weights=weights), rtol=1e-5
    )
    np.testing.assert_allclose(covariances(one)[0], wanted, rtol=1e-4, atol=1e-5)
    assert np.linalg.norm(one.rotations[0]) == pytest.approx(1, abs=1e-5)


def test_a_node_of_one_is_that_one() -> None:
    scene = some(9)
    tree = build_tree(scene.means, scene.colours, np.ones(9), np.ones(9))
    cut = Splits.of(tree).cut(9)
    same = merge(scene, np.ones(9), np.ones(9), tree, cut)
    for name in ("means", "scales", "rotations", "opacities", "colours"):
        assert (getattr(same, name)[cut.labels] == getattr(scene, name)).all()


def test_two_of_the_same_hide_about_as_much_as_before() -> None:
    scene = some(1)
    twice = scene.select(np.array([0, 0]))
    tree = build_tree(twice.means, twice.colours, np.ones(2), np.ones(2))
    one = merge(twice, np.ones(2), np.full(2, 1e-4), tree, Splits.of(tree).cut(1))
    assert one.opacities[0] == pytest.approx(min(2 * scene.opacities[0], 0.99), rel=1e-3)
    np.testing.assert_allclose(np.sort(one.scales[0]), np.sort(scene.scales[0]), rtol=1e-4)
