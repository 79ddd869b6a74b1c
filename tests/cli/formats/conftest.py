"""Scenes to write."""

from __future__ import annotations

import numpy as np
import pytest

from styl3r_cli.gaussians import Gaussians


def random_gaussians(count: int, seed: int = 0) -> Gaussians:
    rng = np.random.default_rng(seed)
    rotations = rng.normal(size=(count, 4))
    return Gaussians(
        means=rng.normal(size=(count, 3)),
        scales=np.exp(rng.uniform(-9, 0, (count, 3))),
        rotations=rotations / np.linalg.norm(rotations, axis=1, keepdims=True),
        opacities=rng.uniform(0, 1, count),
        colours=rng.uniform(0, 1, (count, 3)),
    )


@pytest.fixture
def scene() -> Gaussians:
    return random_gaussians(500)
