"""What views see of each other's places: features that match, and points that meet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.agreement import explained
from styl3r_cli.cameras.bundle import Sightings
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.matches import Matches
from styl3r_cli.cameras.pose_errors import motion
from styl3r_cli.cameras.two_view import rays
from styl3r_cli.meetings import Ground, depths_at, project
from styl3r_cli.overlaps import outwards
from styl3r_cli.pipeline import Scene

Array = NDArray[np.float64]

# Of two views' matches so many, and such a part, must fit the cameras before they have a say.
FEWEST, LEAST_SHARE = 12, 0.5
# Pixels. Between true cameras, matches of real photos lie 0.15 from their epipolar lines (median).
FEATURE_SIGMA = 0.25
# Depths are off by their own errors, which no smooth correction takes away: parts of the parallax.
PARALLAX_SIGMA = 0.03
# What the network saw is kept in mind by how its points meet, every so many pixels. Neighbours'
# are off together, so each counts little (pixels).
MEETING_STEP, MEETING_SIGMA = 16, 4.0
TYPICAL_STEP = 4  # pixels between those whose median depth is a view's
BENDS = 9  # shapes that a view's depths may change by: `bends`


class Views:
    """What views see of each other's places."""

    def __init__(self, scene: Scene, cameras: list[Camera]) -> None:
        self.scene, self.cameras = scene, cameras
        coarse = scene.means[:, ::TYPICAL_STEP, ::TYPICAL_STEP]
        depths = [
            project(points, camera)[2] for points, camera in zip(coarse, cameras, strict=True)
        ]
        self.typical = [_typical(1 / depth[depth > 0]) for depth in depths]

    def features(self, matches: Sequence[Matches], within: float) -> list[Sightings]:
        """Where features are that the cameras explain to so many pixels, both ways."""
        sightings: list[Sightings] = []
        for first, second, pixels in matches:
            one, two = self.cameras[first], self.cameras[second]
            move = motion(one.extrinsics, two.extrinsics)
            fit = explained(move, pixels, one, two, within)
            if fit.sum() < max(FEWEST, LEAST_SHARE * len(fit)):
                continue
            here, there = pixels[0][fit], pixels[1][fit]
            for pair, seen in (((first, second), (here, there)), ((second, first), (there, here))):
                sightings += self._sightings(*pair, *seen, FEATURE_SIGMA, PARALLAX_SIGMA)
        return sightings

    def meetings(self, known: list[int]) -> list[Sightings]:
        """Where the points of the middle view and of each other one are the same surface's.

        These pairs are the ones that the network matched.
        """
        middle, *others = outwards(len(self.cameras), known)
        grounds = {view: Ground.of(self.scene.means[view], self.cameras[view]) for view in known}
        grid = np.s_[MEETING_STEP // 2 :: MEETING_STEP]
        sightings: list[Sightings] = []
        for other in others:
            for view, seer in ((middle, other), (other, middle)):
                meeting = grounds[seer].meet(self.scene.means[view][grid, grid])
                rows, columns = np.nonzero(meeting.agrees)
                at = np.stack([columns, rows, meeting.x[rows, columns], meeting.y[rows, columns]])
                at[:2] = at[:2] * MEETING_STEP + MEETING_STEP // 2
                here, there = (each.T.astype(np.float64) + 0.5 for each in (at[:2], at[2:]))
                sightings += self._sightings(view, seer, here, there, MEETING_SIGMA, 0.0)
        return sightings

    def _sightings(
        self,
        view: int,
        other: int,
        here: Array,
        there: Array,
        sigma: float,
        parallax: float,
    ) -> list[Sightings]:
        """Of a view's places at pixels, which another sees at pixels of its own, if there are any.

        Args:
            view: whose places they are.
            other: who sees them.
            here: (M, 2) pixels of the view's.
            there: (M, 2) pixels of the other's.
            sigma: in pixels.
            parallax: what is added to it along the way that depth moves them, parts of that way.
        """
        one, two = self.cameras[view], self.cameras[other]
        depths = depths_at(self.scene.means[view], one.extrinsics, here)
        with np.errstate(all="ignore"):
            near = 1 / depths
            move = motion(one.extrinsics, two.extrinsics)
            turned = rays(here, one.intrinsics) @ move[:3, :3].T
            far, place = _flat(turned), _flat(turned + near[:, None] * move[:3, 3])
            shift = np.linalg.norm(place - far, axis=1)
            along = move[:2, 3] - place * move[2, 3]
            along /= np.linalg.norm(along, axis=1)[:, None]
        good = (depths > 0) & np.isfinite(shift) & np.isfinite(along).all(axis=1)
        if not good.any():
            return []
        shapes = bends(here, near, self.typical[view], one)[good]
        across = np.full(int(good.sum()), sigma / two.fx)
        sigmas = np.stack([np.hypot(across, parallax * shift[good]), across], axis=1)
        seen = rays(there, two.intrinsics)[good, :2]
        towards = rays(here, one.intrinsics)[good]
        return [Sightings(view, other, towards, near[good], shapes, seen, along[good], sigmas)]


def _flat(places: Array) -> Array:
    return places[:, :2] / places[:, 2:]


def _typical(nearness: Array) -> float:
    """The median of what is finite; 0 where nothing is."""
    finite = nearness[np.isfinite(nearness)]
    return float(np.median(finite)) if len(finite) else 0.0


def bends(pixels: Array, nearness: Array, typical: float, camera: Camera) -> Array:
    """(M, BENDS) shapes that a view's depths may change by, all in units of nearness.

    A wrong pose or lens of a camera that sees the same changes inverse depths, to first order, by
    a part that varies linearly over the picture, and by a sum that varies as a quadric.

    Args:
        pixels: (M, 2).
        nearness: (M,) inverse depths there.
        typical: the view's median of them.
        camera: the view's.
    """
    x, y = (pixels * 2 / np.array([camera.width, camera.height]) - 1).T
    one = np.ones_like(x)
    part = nearness * np.stack([one, x, y])
    return np.concatenate([part, typical * np.stack([one, x, y, x * x, x * y, y * y])]).T
