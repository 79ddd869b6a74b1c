"""Where one view's points lie in what another view shows: on it, before it, or behind it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import FloatArray

# Two views' depths of one surface differ by a few per cent, of two surfaces by more: below the
# first part of the depth a point is the other view's, beyond the second it is not.
SAME, ANOTHER = 0.07, 0.10
# All of 3x3 pixels of the other view have to be at that depth: beside an edge there, colours of the
# surface in front would come along.
NEIGHBOURS = 3
# A picture's outermost pixels are painted with less around them to go by, and no seam should be
# sharp: so many pixels from the border nothing is taken, and from there on all.
BORDER, INSIDE = 3.0, 5.0
# Pixels of the other picture that a pixel spans: with fewer, what was taken would be coarser.
TOO_COARSE, FINE_ENOUGH = 0.5, 0.8


@dataclass(frozen=True)
class Ground:
    """What a view shows, to compare other views' points with.

    Attributes:
        camera: the view's.
        near: (H, W) least depth of the pixels around each.
        far: (H, W) greatest depth of them.
    """

    camera: Camera
    near: FloatArray
    far: FloatArray

    @classmethod
    def of(cls, points: FloatArray, camera: Camera) -> Ground:
        """That of a view's (H, W, 3) points."""
        import cv2

        depth = project(points, camera)[2].astype(np.float32)
        depth = np.where(np.isfinite(depth), depth, np.float32(0))  # no point has that depth
        kernel = np.ones((NEIGHBOURS, NEIGHBOURS), np.uint8)
        near, far = cv2.erode(depth, kernel), cv2.dilate(depth, kernel)
        return cls(camera, np.asarray(near, np.float32), np.asarray(far, np.float32))

    def meet(self, points: FloatArray) -> Meeting:
        """Compare another view's (H, W, 3) points with it."""
        u, v, depth = project(points, self.camera)
        height, width = self.near.shape
        with np.errstate(all="ignore"):
            nowhere = ~(np.isfinite(u + v) & (np.abs(u) < 2 * width) & (np.abs(v) < 2 * height))
            x, y = (np.where(nowhere, -1, each).astype(np.float32) for each in (u, v))
            before = (sample(self.near, x, y) - depth) / depth
            behind = (depth - sample(self.far, x, y)) / depth
            apart = np.maximum(-before, -behind)
        border = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y)) + 0.5
        return Meeting(x, y, border, before, behind, apart)


@dataclass(frozen=True)
class Meeting:
    """Where a view's points lie in what another view shows; all (H, W).

    Attributes:
        x: pixels from the first pixel's centre; -1 for points that are at no pixel.
        y: likewise.
        border: pixels to the nearest border of the picture, negative outside.
        before: by what part of its depth a point is in front of all that is around its pixel.
        behind: by what part it is behind all of that.
        apart: by what part it is away from what is farthest from it there.
    """

    x: FloatArray
    y: FloatArray
    border: FloatArray
    before: NDArray[np.floating]
    behind: NDArray[np.floating]
    apart: NDArray[np.floating]

    @property
    def through(self) -> NDArray[np.bool_]:
        """Whether the other view looks through a point."""
        return (self.border > BORDER) & (self.before > ANOTHER)

    @property
    def agrees(self) -> NDArray[np.bool_]:
        """Whether it sees something there."""
        return (self.border > BORDER) & (self.before < SAME) & (self.behind < SAME)

    def share(self) -> FloatArray:
        """How much of each pixel's surface is what the other view shows: `Overlap.share`."""
        with np.errstate(all="ignore"):
            # Below 0 where the other picture is a mirror's: it shows the surface from behind.
            spans = np.gradient(self.x, axis=1) * np.gradient(self.y, axis=0)
            spans -= np.gradient(self.x, axis=0) * np.gradient(self.y, axis=1)
            share = (
                _ramp(self.apart, ANOTHER, SAME)
                * _ramp(self.border, BORDER, INSIDE)
                * _ramp(spans, TOO_COARSE, FINE_ENOUGH)
            )
        return np.where(np.isfinite(share), share, 0).astype(np.float32)


def project(
    points: NDArray[np.floating], camera: Camera
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Pixel coordinates (from the first pixel's centre) and depths of (H, W, 3) points.

    Points that are not in front of the camera are at no pixel: NaN.
    """
    with np.errstate(all="ignore"):
        seen = points @ camera.extrinsics[:3, :3].T + camera.extrinsics[:3, 3]
        depth = np.where(seen[..., 2] > 0, seen[..., 2], np.nan)
        x = camera.fx * seen[..., 0] / depth + camera.cx - 0.5
        y = camera.fy * seen[..., 1] / depth + camera.cy - 0.5
    return x, y, depth


def depths_at(
    points: FloatArray, extrinsics: NDArray[np.float64], pixels: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(M,) depths that a view's (H, W, 3) points have at pixels (M, 2), those outside at the rim.

    What is not finite there is none of them.
    """
    height, width = points.shape[:2]
    column = pixels[:, 0].astype(int).clip(0, width - 1)
    row = pixels[:, 1].astype(int).clip(0, height - 1)
    with np.errstate(invalid="ignore"):
        there = points[row, column].astype(np.float64)
        return np.asarray(there @ extrinsics[2, :3] + extrinsics[2, 3])


def _ramp(values: NDArray[np.floating], none: float, full: float) -> NDArray[np.floating]:
    """0 at `none`, 1 at `full`, between them on a line."""
    return np.clip((values - none) / (full - none), 0, 1)


def sample(picture: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """A picture's values at (H, W) places: cubic for colours, which linear would blur."""
    import cv2

    how = cv2.INTER_CUBIC if picture.ndim == 3 else cv2.INTER_LINEAR
    sampled = cv2.remap(np.ascontiguousarray(picture), x, y, how, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(sampled, np.float32)
