"""Where a frame's time goes."""

from __future__ import annotations

import cProfile
import pstats
import statistics
from collections.abc import Callable
from typing import Any

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.splatting import renderer

STAGES = ("near plane", "projection", "tile lists", "blending", "planes")


def stage_seconds(scene: Gaussians, camera: Camera, threads: int, repeats: int) -> dict[str, float]:
    """Seconds by the clock of each of STAGES, in the median frame.

    Tile lists include the sorting by depth; planes are what is made of the blended ones in numpy.
    """
    frames = [_one(scene, camera, threads) for _ in range(repeats)]
    return {stage: statistics.median(frame[stage] for frame in frames) for stage in STAGES}


def _one(scene: Gaussians, camera: Camera, threads: int) -> dict[str, float]:
    profile = cProfile.Profile()
    profile.runcall(renderer.render, scene, camera, threads=threads)
    # A frame is some hundred calls of Python, so that watching them costs next to nothing; the
    # compiled kernels' threads work while the calls below wait for them.
    found: dict[Any, Any] = pstats.Stats(profile).stats  # type: ignore[attr-defined]

    def within(function: Callable[..., Any]) -> float:
        code = function.__code__
        return float(found[code.co_filename, code.co_firstlineno, code.co_name][3])

    whole = within(renderer.render)
    near, projected = within(renderer.near_plane), within(renderer.project)
    blended, listed = within(renderer.accumulate), within(renderer.tile_lists)
    rest = whole - near - projected - blended
    return dict(zip(STAGES, (near, projected, listed, blended - listed, rest), strict=True))
