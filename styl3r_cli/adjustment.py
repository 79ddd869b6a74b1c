"""Cameras and depths brought together with the features that photos share.

The network matches views in cells of 8 pixels, and every view with the middle one only. SIFT's
features are where they are to a fifth of a pixel, and all views' count. Cameras turn and shift
until features meet; depths follow by a smooth correction of each view, so that what the views
agreed about stays together, and edges stay where they are. So does a lens that was only guessed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.bundle import POSE, Adjusted, adjust, misfit
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.matches import Matches
from styl3r_cli.cameras.pointmap import inlier_ratio, pixel_centres
from styl3r_cli.cameras.poses import centre
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.meetings import depths_at
from styl3r_cli.moved_views import change_lens, copied, move_view, scale_depths
from styl3r_cli.pipeline import Scene
from styl3r_cli.view_sightings import BENDS, Views, bends

Array = NDArray[np.float64]

# An unknown must be worth so much of the features' robust cost, or all stays as it is: with few
# features, or where the network is as good as they are, adjustment follows their noise.
WORTH = 1.0
# Pixels from their lines within which matches count, round by round: in the first, cameras that
# are a degree off explain none to 2 pixels.
ROUNDS = (10.0, 2.0)
MOST_BEND = 2.0  # depths change by no larger factor
TOLD_ZOOM = 0.05  # a lens that changed by a larger part is worth telling about


def adjusted(
    scene: Scene, recovered: Recovered, matches: Sequence[Matches], any_lens: bool = False
) -> tuple[Scene, Recovered]:
    """The scene and its cameras after bundle adjustment; as they were if it is of no use.

    The first view's camera stays. Views whose camera is not known stay, too. Same input, same
    result.

    Args:
        scene: from `Stylizer.encode`.
        recovered: its cameras.
        matches: of its views.
        any_lens: whether the focal lengths were guessed: one factor for all may change them.
    """
    before = recovered.cameras[0]
    known = np.flatnonzero(recovered.recovered).tolist()
    usable = [each for each in matches if {each.first, each.second} <= {*known}]
    for within in ROUNDS:
        views = Views(scene, recovered.cameras)
        found = _adjustment(views, known, usable, within, any_lens)
        if found is not None:
            scene, recovered = _applied(views, known, found, recovered)
    return scene, _told(recovered, before)


def _adjustment(
    views: Views, known: list[int], matches: Sequence[Matches], within: float, any_lens: bool
) -> Adjusted | None:
    """What brings the known views' features together, if that is worth it."""
    extrinsics = np.stack([camera.extrinsics for camera in views.cameras])
    eyes = [centre(extrinsics[view]) for view in known]
    steps = [float(np.linalg.norm(one - other)) for one, other in combinations(eyes, 2)]
    unit = float(np.median(steps)) if steps else 0.0
    features = views.features(matches, within)
    if not features or not 0 < unit < np.inf:
        return None
    found = adjust([*features, *views.meetings(known)], extrinsics, unit, any_lens)
    start = Adjusted(extrinsics, np.zeros_like(found.coefficients))
    unknowns = POSE * (len(known) - 1) + BENDS * len(known) + any_lens
    worth = misfit(features, start) - misfit(features, found)
    return found if worth >= WORTH * unknowns else None


def _applied(
    views: Views, known: list[int], found: Adjusted, recovered: Recovered
) -> tuple[Scene, Recovered]:
    """The scene and its cameras as an adjustment has them."""
    scene, zoom = copied(views.scene), float(np.exp(found.zoom))
    cameras = [replace(each, fx=each.fx * zoom, fy=each.fy * zoom) for each in recovered.cameras]
    ratios = list(recovered.inlier_ratios)
    for view in known:
        before, extrinsics = recovered.cameras[view], found.extrinsics[view]
        _bend(scene, view, before, found.coefficients[view], views.typical[view])
        if zoom != 1:
            change_lens(scene, view, before, zoom)
        move_view(scene, view, np.linalg.inv(extrinsics) @ before.extrinsics)
        cameras[view] = replace(cameras[view], extrinsics=extrinsics)
        ratios[view] = inlier_ratio(scene.means[view], scene.opacities[view], cameras[view])
    focal = None if recovered.focal is None else recovered.focal * zoom
    return scene, replace(recovered, cameras=cameras, inlier_ratios=ratios, focal=focal)


def _bend(scene: Scene, view: int, camera: Camera, coefficients: Array, typical: float) -> None:
    """Move a view's Gaussians nearer or farther on their rays."""
    height, width = scene.means.shape[1:3]
    pixels = pixel_centres(height, width).reshape(-1, 2)
    with np.errstate(all="ignore"):
        nearness = 1 / depths_at(scene.means[view], camera.extrinsics, pixels)
        factor = 1 / (1 + bends(pixels, nearness, typical, camera) @ coefficients / nearness)
    factor = np.where(nearness > 0, factor.clip(1 / MOST_BEND, MOST_BEND), 1.0)
    scale_depths(scene, view, camera, factor.reshape(height, width))


def _told(recovered: Recovered, before: Camera) -> Recovered:
    """With a note on the lens, if it is another one now."""
    times = recovered.cameras[0].fx / before.fx
    if abs(np.log(times)) <= np.log1p(TOLD_ZOOM):
        return recovered
    note = f"features that match fit {times:.2f} times the focal length that was assumed: taken"
    return replace(recovered, focal_notes=[*recovered.focal_notes, note])
