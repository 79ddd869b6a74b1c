"""Cameras of the views from the point maps that the structure graph predicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.pnp import find_pose
from styl3r_cli.cameras.pointmap import estimate_focal, inlier_ratio

# Guessing 28 mm for a lens between 24 and 35 mm is off by less; more deserves a note.
FOCAL_DISAGREEMENT = 0.25
# A pose found with the wide threshold may have that few points within 1 % of the frame: then it
# can be a wrong one that bends towards them, and a user should look.
DOUBTFUL = 0.1


@dataclass(frozen=True)
class Recovered:
    """The views' cameras.

    Attributes:
        cameras: one per view, in pixels of the network's frame; the first is the world frame.
        inlier_ratios: per view, the opacity-weighted share of its points that its camera projects
            to within 1 % of the frame of their own pixels.
        recovered: per view, whether its pose was found (True for the first); False means that a
            neighbour's stands in.
        focal: the first view's fx as its point map says, pixels; None where it says nothing.
        focal_given: the first view's fx as the network was told, pixels; None where it was not.
        focal_notes: one line each on what is wrong with the lens.
        view_notes: one line each on what is wrong with views, or was, by their indices.
    """

    cameras: list[Camera]
    inlier_ratios: list[float]
    recovered: list[bool]
    focal: float | None
    focal_given: float | None
    focal_notes: list[str]
    view_notes: dict[int, str] = field(default_factory=dict)

    @property
    def notes(self) -> list[str]:
        """One line each on what went wrong, views in their order."""
        return [*self.focal_notes, *(self.view_notes[view] for view in sorted(self.view_notes))]


def recover(
    means: NDArray[np.float32],
    opacities: NDArray[np.float32],
    intrinsics: NDArray[np.float32] | None = None,
    measured: Sequence[bool] | None = None,
) -> Recovered:
    """Find where each view was taken from.

    The first view's camera is the world frame, so its points give its focal length. A view keeps
    a focal length that was measured; others get the given one times the first view's correction,
    which preserves zoom between views. The other views' poses come from their points, which are in
    the world frame already. A view without a believable pose gets the one before it and a note:
    never a mirrored or a made-up one. Same input, same result.

    Args:
        means: (N, H, W, 3) the point maps, world frame, OpenCV axes.
        opacities: (N, H, W) in [0, 1]: opaque points count more.
        intrinsics: (N, 3, 3) normalised by width and height, as the network was given them.
        measured: N times whether the given focal length is to be kept (EXIF, set by the user); by
            default none is.
    """
    views, height, width = opacities.shape
    given = _given_cameras(intrinsics, views, height, width)
    keep = [False] * views if measured is None or intrinsics is None else list(measured)
    focal = estimate_focal(means[0], opacities[0], given[0])
    correction = 1.0 if focal is None else focal / given[0].fx
    focal_notes = _focal_notes(focal, given[0].fx if intrinsics is not None else None, width)
    cameras: list[Camera] = []
    recovered: list[bool] = []
    notes: dict[int, str] = {}
    for view in range(views):
        factor = 1.0 if keep[view] else correction
        camera = replace(given[view], fx=given[view].fx * factor, fy=given[view].fy * factor)
        pose = np.eye(4) if view == 0 else find_pose(means[view], opacities[view], camera)
        recovered.append(pose is not None)
        if pose is None:
            pose = cameras[-1].extrinsics
            notes[view] = (
                f"view {view + 1}: no camera explains its points; view {view}'s stands in for it"
            )
        cameras.append(replace(camera, extrinsics=pose))
    ratios = [inlier_ratio(*view) for view in zip(means, opacities, cameras, strict=True)]
    notes |= {
        view: f"view {view + 1}: only {ratio:.0%} of its points fit its camera, which may be wrong"
        for view, ratio in enumerate(ratios)
        if view > 0 and recovered[view] and ratio < DOUBTFUL
    }
    told = given[0].fx if intrinsics is not None else None
    return Recovered(cameras, ratios, recovered, focal, told, focal_notes, notes)


def _given_cameras(
    intrinsics: NDArray[np.float32] | None, views: int, height: int, width: int
) -> list[Camera]:
    """Cameras in the world frame with the given intrinsics, or with ones to be corrected."""
    if intrinsics is None:
        longer = float(max(width, height))
        camera = Camera(np.eye(4), longer, longer, width / 2, height / 2, width, height)
        return [camera] * views
    scaled = intrinsics.astype(np.float64) * np.array([[width], [height], [1.0]])
    return [Camera(np.eye(4), k[0, 0], k[1, 1], k[0, 2], k[1, 2], width, height) for k in scaled]


def _focal_notes(focal: float | None, given: float | None, width: int) -> list[str]:
    if focal is None:
        return ["the first view's points tell no focal length; the given one is kept"]
    if given is None or abs(np.log(focal / given)) < np.log1p(FOCAL_DISAGREEMENT):
        return []
    found, told = (np.degrees(2 * np.arctan(width / 2 / value)) for value in (focal, given))
    return [
        f"the first view's points suggest a field of view of {found:.0f} degrees across, "
        f"its photo {told:.0f}"
    ]
