"""The cameras that a compaction answers to: the views, and halfway from each to the next."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from styl3r_cli.cameras import poses
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.frames import reduced
from styl3r_cli.gaussians import Gaussians

# The network makes scenes of 256x256 pixels a view from at most 8 views. What is larger or more is
# taken in part: a compaction stays a matter of seconds, also for a film's camera file.
LARGEST_SIDE = 512
MOST_VIEWS = 8
# A scene without cameras is looked at from all around, at the size that scenes are made at.
AROUND, AROUND_SIDE = 12, 256


def witnesses(views: Sequence[Camera], gaussians: Gaussians) -> list[Camera]:
    """Cameras from which a scene is plausibly looked at.

    Args:
        views: where the photos were taken; empty if that is not known.
        gaussians: the scene, for where to look from then.
    """
    if not views:
        from styl3r_cli.cameras.overview import default_camera
        from styl3r_cli.cameras.paths import make_path

        around = make_path("orbit", [], gaussians, AROUND)
        return [reduced(camera, AROUND_SIDE) for camera in [default_camera(gaussians), *around]]
    if len(views) > MOST_VIEWS:
        chosen = np.linspace(0, len(views) - 1, MOST_VIEWS).round().astype(int)
        views = [views[index] for index in chosen]
    views = [reduced(camera, LARGEST_SIDE) for camera in views]
    return [*views, *in_between(views, (0.5,))]


def in_between(views: Sequence[Camera], places: Sequence[float]) -> list[Camera]:
    """Cameras on the way from each view to the next, at these fractions of it."""
    return [
        poses.to_camera(poses.blend(poses.from_camera(a), poses.from_camera(b), place), a)
        for a, b in pairwise(views)
        for place in places
    ]
