"""A scene, its cameras' file, and the command `render`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from two_cameras import CAMERAS, Run

from styl3r_cli import main
from styl3r_cli.cameras.stored import cameras_to_metadata
from styl3r_cli.cameras.transforms import write_transforms
from styl3r_cli.formats import write_scene
from styl3r_cli.gaussians import Gaussians


@pytest.fixture(scope="session")
def gaussians() -> Gaussians:
    rng = np.random.default_rng(5)
    means = rng.uniform([-1, -1, 2], [1, 1, 3], (300, 3))
    return Gaussians(
        means=means,
        scales=rng.uniform(0.03, 0.1, (300, 3)),
        rotations=np.tile([1.0, 0, 0, 0], (300, 1)),
        opacities=rng.uniform(0.5, 1, 300),
        colours=rng.uniform(0, 1, (300, 3)),
    )


@pytest.fixture
def scene(gaussians: Gaussians, tmp_path: Path) -> Path:
    write_scene(tmp_path / "scene.ply", gaussians, cameras_to_metadata(CAMERAS))
    return tmp_path / "scene.ply"


@pytest.fixture
def cameras(tmp_path: Path) -> Path:
    write_transforms(tmp_path / "transforms.json", CAMERAS, ["a.jpg", "b.jpg"])
    return tmp_path / "transforms.json"


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    def run_command(*arguments: object) -> tuple[int, str]:
        code = main.run(["render", "--threads", "1", *map(str, arguments)])
        out, err = capsys.readouterr()
        assert out == ""
        return code, err

    return run_command
