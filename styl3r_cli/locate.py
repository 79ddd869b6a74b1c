"""Where a scene's photos were taken from: by the network's points, then by features that match."""

from __future__ import annotations

from styl3r_cli.adjustment import adjusted
from styl3r_cli.cameras.matches import as_pictures, match_views
from styl3r_cli.cameras.recover import Recovered, recover
from styl3r_cli.photos.load import Photos
from styl3r_cli.pipeline import Scene
from styl3r_cli.placement import placed
from styl3r_cli.smoothing import smoothed
from styl3r_cli.stereo.dense import dense


def locate_views(
    scene: Scene, photos: Photos | None = None, threads: int | None = None
) -> tuple[Scene, Recovered]:
    """Find where each view was taken from, and bring the views together.

    Args:
        scene: from `Stylizer.encode`.
        photos: that it was encoded from: they show more features than the network's small
            pictures, and say whose focal length was measured: where any was, all are kept.
            Without them the lens counts as guessed.
        threads: None for every core.

    Returns:
        The scene, with views moved that were in the wrong place, all of them as their features
        meet, depths where views look alike, and without grain; and its cameras.
    """
    measured = None if photos is None else photos.focals_measured
    recovered = recover(scene.means, scene.opacities, scene.intrinsics, measured)
    details = () if photos is None else photos.details
    pictures = list(details) or as_pictures(scene.images)
    matches = match_views(pictures, scene.images.shape[2:], threads)
    scene, recovered = placed(scene, recovered, matches)
    guessed = measured is None or not any(measured)
    scene, recovered = adjusted(scene, recovered, matches, any_lens=guessed)
    scene = dense(scene, recovered, pictures, threads)
    return smoothed(scene, recovered.cameras), recovered
