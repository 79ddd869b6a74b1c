"""Where a scene's photos were taken from: by the network's points, then by features that match."""

from __future__ import annotations

from collections.abc import Sequence

from styl3r_cli.adjustment import adjusted
from styl3r_cli.cameras.matches import match_views
from styl3r_cli.cameras.recover import Recovered, recover
from styl3r_cli.pipeline import Scene
from styl3r_cli.placement import placed


def locate_views(
    scene: Scene, measured: Sequence[bool] | None = None, threads: int | None = None
) -> tuple[Scene, Recovered]:
    """Find where each view was taken from, and bring the views together.

    Args:
        scene: from `Stylizer.encode`.
        measured: as `recover` takes it: whether each view's focal length is to be kept.
        threads: None for every core.

    Returns:
        The scene, with views moved that were in the wrong place, and all of them as their features
        meet; and its cameras.
    """
    recovered = recover(scene.means, scene.opacities, scene.intrinsics, measured)
    matches = match_views(scene.images, threads)
    return adjusted(*placed(scene, recovered, matches), matches)
