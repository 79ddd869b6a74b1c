"""The scene that the tests of this folder trace."""

from __future__ import annotations

import pytest
from layered_scene import layered_scene, views

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.compaction import witnesses
from styl3r_cli.gaussians import Gaussians


@pytest.fixture(scope="session")
def scene() -> Gaussians:
    return layered_scene()


@pytest.fixture(scope="session")
def cameras(scene: Gaussians) -> list[Camera]:
    return witnesses(views(), scene)
