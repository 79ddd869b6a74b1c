"""Memory that ends in work of every kind: done, or refused in one line; never a crash or a wait."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from limited import KINDS, limited, one_line

from styl3r_cli import needs
from styl3r_cli.formats import write_scene
from styl3r_cli.gaussians import Gaussians

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="the limits are Linux's"),
]


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A file with some thousand Gaussians."""
    rng, count = np.random.default_rng(0), 5000
    means = rng.uniform([-1, -1, 3], [1, 1, 5], (count, 3)).astype(np.float32)
    shapes = np.full((count, 3), 0.05, np.float32), np.tile(np.float32([1, 0, 0, 0]), (count, 1))
    opacities, colours = np.full(count, 0.9, np.float32), rng.uniform(0, 1, (count, 3))
    path = tmp_path / "scene.ply"
    write_scene(path, Gaussians(means, *shapes, opacities, colours.astype(np.float32)))
    return path


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("views", [2, 4])
@pytest.mark.parametrize("quality", ["best", "balanced"])
def test_what_is_said_to_be_enough_is(
    tmp_path: Path, make_picture: Callable[..., Path], kind: str, views: int, quality: str
) -> None:
    """The bundled network at its own size, with a film: a byte less is refused."""
    photos = [make_picture(tmp_path / f"{index}.png", seed=index) for index in range(views)]
    command = [sys.executable, "-m", "styl3r_cli", "stylize", *map(str, photos), "-q"]
    command += ["-s", str(photos[0]), "--fov", "50", "--quality", quality]
    command += ["-o", str(tmp_path / "x.ply"), "--video", str(tmp_path / "x.mp4")]
    pixels = views * 256 * 256
    need = needs.scene(pixels) if quality == "best" else needs.network(pixels, shown=True)
    least = getattr(need, kind)
    for limit, expected in ((least - 1, 1), (least, 0)):
        settings = {"preexec_fn": limited(kind, limit), "timeout": 600, "check": False}
        done = subprocess.run(command, capture_output=True, **settings)  # type: ignore[call-overload]
        assert (done.returncode, done.stderr == b"") == (expected, expected == 0)
    assert (tmp_path / "x.mp4").exists()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("megabytes", [200, 400, 600, 900, 1100, 1320])
def test_memory_that_ends_while_drawing(
    scene: Path, tmp_path: Path, megabytes: int, kind: str
) -> None:
    """Under less than the least, numba would wait for ever, and encoders crash."""
    film = tmp_path / "a.mp4"
    command = [sys.executable, "-m", "styl3r_cli", "render", str(scene), "-o", str(film)]
    command += ["-q", "--frames", "2", "--size", "32", "--threads", "1"]
    settings = {"preexec_fn": limited(kind, megabytes << 20), "timeout": 200, "check": False}
    done = subprocess.run(command, capture_output=True, **settings)  # type: ignore[call-overload]
    left = {path.name for path in tmp_path.iterdir()} - {scene.name}
    assert left == ({film.name} if done.returncode == 0 else set())
    if done.returncode:
        assert (done.returncode, one_line(done.stderr.decode())) == (1, True)
        assert b"out of memory" in done.stderr


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("megabytes", [150, 205, 230, 293, 300, 430])
def test_memory_that_ends_while_sizes_are_told(scene: Path, megabytes: int, kind: str) -> None:
    """Scipy's OpenBLAS would ask for ever."""
    command = [sys.executable, "-m", "styl3r_cli", "info", str(scene)]
    settings = {"preexec_fn": limited(kind, megabytes << 20), "timeout": 200, "check": False}
    done = subprocess.run(command, capture_output=True, **settings)  # type: ignore[call-overload]
    if done.returncode:
        assert (done.returncode, one_line(done.stderr.decode())) == (1, True)
        assert b"out of memory" in done.stderr
