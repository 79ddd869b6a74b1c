"""Errors of recovered cameras, beside no motion at all and classical two-view geometry."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.pose_errors import direction_error, motion, rotation_error
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.cameras.two_view import relative_pose
from styl3r_export.evaluate.groups import Group
from styl3r_export.evaluate.records import MODEL, Values


def camera_values(
    group: Group, recovered: Recovered, given: Sequence[Camera], assumed_focal: float
) -> Values:
    """Errors in degrees of the relative poses of all pairs of a group's views.

    `rotation` is the angle between relative rotations, `direction` the angle between relative
    translations (not folded at 90 degrees), `larger of both` is what AUC is computed from.

    Baselines: `identity` says that the camera did not move; `SIFT + E` matches SIFT features and
    solves for the essential matrix, pair by pair, in the same crops, as large as the tool looks at
    them, with the intrinsics that the network was given, and says identity where that finds
    nothing.

    Args:
        group: the true cameras.
        recovered: the model's cameras.
        given: cameras with the intrinsics that the network was given, in pixels of the crop.
        assumed_focal: fx of the first view as assumed for a photo without EXIF data, pixels.
    """
    values: Values = {}
    for a, b in combinations(range(len(group.views)), 2):
        truth = motion(group.views[a].camera.extrinsics, group.views[b].camera.extrinsics)
        pictures = [group.views[view].finest for view in (a, b)]
        lenses = [
            camera.resized(*picture.shape[1::-1]).intrinsics
            for camera, picture in zip((given[a], given[b]), pictures, strict=True)
        ]
        sift = relative_pose(pictures[0], pictures[1], lenses[0], lenses[1])
        guesses = {
            MODEL: motion(recovered.cameras[a].extrinsics, recovered.cameras[b].extrinsics),
            "identity": np.eye(4),
            "SIFT + E": np.eye(4) if sift is None else sift,
        }
        for method, guess in guesses.items():
            turn, direction = rotation_error(guess, truth), direction_error(guess, truth)
            for name, error in (
                ("rotation (deg)", turn),
                ("direction (deg)", direction),
                ("larger of both (deg)", max(turn, direction)),
            ):
                values.setdefault(("cameras", name, method), []).append(error)
    true_focal = group.views[0].camera.fx
    found_focal = given[0].fx if recovered.focal is None else recovered.focal
    for method, focal in ((MODEL, found_focal), ("28 mm assumed", assumed_focal)):
        values["cameras", "focal length (relative)", method] = [abs(focal / true_focal - 1)]
    return values


def area_under_recall(errors: Sequence[float], limit: float) -> float:
    """AUC: mean recall over all thresholds up to `limit` (as in SuperGlue, Sarlin et al. 2020).

    Recall is linear between errors, the first of them reached from 0.
    """
    ordered = np.concatenate([[0.0], np.sort(errors)])
    recall = np.arange(len(ordered)) / len(errors)
    last = int(np.searchsorted(ordered, limit))
    x = np.concatenate([ordered[:last], [limit]])
    y = np.concatenate([recall[:last], [recall[last - 1]]])
    return float(np.trapezoid(y, x) / limit)
