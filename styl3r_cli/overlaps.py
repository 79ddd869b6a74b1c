"""Which pixels of the views show one surface, so that it is painted, and kept, once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.gaussians import FloatArray
from styl3r_cli.pipeline import Scene

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
# A pixel's Gaussian is a repeat if of the BAND x BAND pixels around it less than this share is the
# view's own: where views meet, both are kept for a few pixels, or their seam shows.
BAND, OWN_SHARE = 5, 0.2
MOSTLY = 0.5  # a share beyond which a pixel is the other view's
MOST_OPAQUE = 0.99  # more is never drawn (Kerbl et al. 2023, section 6)


@dataclass(frozen=True)
class Overlap:
    """What a view sees that another one painted.

    Attributes:
        view: index of the view.
        painter: index of the view whose picture is taken.
        share: (H, W) in [0, 1], how much of it.
        x: (H, W) where in the painter's picture, pixels from its first pixel's centre.
        y: (H, W) likewise.
    """

    view: int
    painter: int
    share: FloatArray
    x: FloatArray
    y: FloatArray


class Overlaps:
    """Where the views of a scene show one surface.

    A 2D stylizer paints every view for itself: the same wall gets other strokes in each, and drawn
    from the Gaussians of all views they blur each other. Here every surface keeps the strokes of
    one view, the others take them over at the points' projections. What depends on the style is
    one resampling.

    The same holds for the Gaussians: of a surface that several views show one view's are enough.
    The others would lie before and behind them, by what depths are wrong.

    Attributes:
        order: the views whose camera is known, the one that others take from first.
        own: (N, H, W) in [0, 1], how much of a pixel no view that is earlier in order shows.
        kept: (N, H, W), whether the pixel's Gaussian is needed: not if it repeats another view's.

    Example:
        >>> overlaps = Overlaps(scene, recovered)
        >>> agreeing = overlaps.paint_once(pictures)
    """

    def __init__(self, scene: Scene, recovered: Recovered) -> None:
        """Compare the views' depths.

        Args:
            scene: from `Stylizer.encode`.
            recovered: its cameras. Views whose camera was not found neither give nor take.
        """
        import cv2

        known = np.flatnonzero(recovered.recovered).tolist()
        self.order = outwards(len(scene.images), known)
        self.overlaps = list(self._compare(scene, recovered.cameras))
        self.own = np.ones(scene.means.shape[:3], np.float32)
        for each in self.overlaps:
            self.own[each.view] *= 1 - each.share
        self.kept = np.ones(self.own.shape, np.bool_)
        for view in self.order:
            around = cv2.blur(self.own[view], (BAND, BAND))
            self.kept[view] = (around > OWN_SHARE) | ~self._stands(view)

    def _stands(self, view: int) -> NDArray[np.bool_]:
        """(H, W), whether a repeat's other Gaussian is kept here: it may be a repeat itself."""
        import cv2

        stands = np.zeros(self.own.shape[1:], np.uint8)
        for each in self.overlaps:
            if each.view == view:
                there = _sample(self.kept[each.painter].astype(np.float32), each.x, each.y)
                stands |= ((each.share > 0) & (there > 0)).astype(np.uint8)
        return np.asarray(cv2.dilate(stands, np.ones((BAND, BAND), np.uint8))) > 0

    def _compare(self, scene: Scene, cameras: list[Camera]) -> Iterator[Overlap]:
        depths = {
            view: project(scene.means[view], cameras[view])[2].astype(np.float32)
            for view in self.order
        }
        for index, view in enumerate(self.order):
            for painter in self.order[:index]:
                x, y, depth = project(scene.means[view], cameras[painter])
                yield Overlap(view, painter, *_share(x, y, depth, depths[painter]))

    def paint_once(self, pictures: FloatArray, strength: float = 1.0) -> FloatArray:
        """The views' pictures with each surface as the first view in order painted it.

        Args:
            pictures: (N, H, W, 3), each view painted for itself.
            strength: how much of what another view painted is taken over, 0 to 1.

        Returns:
            (N, H, W, 3).
        """
        painted = pictures.copy()
        left = np.full(pictures.shape[:3], np.float32(strength))
        for each in self.overlaps:  # the earliest painter first
            taken = left[each.view] * each.share
            change = _sample(pictures[each.painter], each.x, each.y) - pictures[each.view]
            painted[each.view] += taken[..., None] * change
            left[each.view] -= taken
        return painted

    def opacities(self, opacities: FloatArray) -> FloatArray:
        """Of the Gaussians that are kept: with what the repeats that lay on them covered besides.

        Two layers of opacities a and b let (1 - a)(1 - b) through, and one that stands for both
        has to let through as little.

        Args:
            opacities: (N, H, W), the network's.

        Returns:
            (N, H, W), 0 for repeats.
        """
        through = 1 - opacities
        for each in self.overlaps:
            repeats = (each.share > MOSTLY) & ~self.kept[each.view]
            below = tuple(np.rint(at[repeats]).astype(np.intp) for at in (each.y, each.x))
            layer = np.ones_like(each.share)
            # NaN, which the network's opacities may be, leaves the other layer alone.
            np.fmin.at(layer, below, np.clip(1 - opacities[each.view][repeats], 0, 1))
            through[each.painter] *= layer
        merged = np.minimum(1 - through, np.maximum(opacities, np.float32(MOST_OPAQUE)))
        return np.where(self.kept, merged, 0).astype(np.float32)


def outwards(count: int, known: list[int]) -> list[int]:
    """Known views from the middle of `count` on, which shares most with the others."""
    middle = (count - 1) // 2
    return sorted(known, key=lambda view: (abs(view - middle), view))


def project(
    points: FloatArray, camera: Camera
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


def _share(
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    depth: NDArray[np.float64],
    there: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """How much a view takes at each pixel, and where from: `Overlap`'s share, x and y."""
    import cv2

    height, width = there.shape
    kernel = np.ones((NEIGHBOURS, NEIGHBOURS), np.uint8)
    there = np.where(np.isfinite(there), there, np.float32(0))  # no point has that depth
    near = np.asarray(cv2.erode(there, kernel), np.float32)
    far = np.asarray(cv2.dilate(there, kernel), np.float32)
    with np.errstate(all="ignore"):
        nowhere = ~(np.isfinite(u + v) & (np.abs(u) < 2 * width) & (np.abs(v) < 2 * height))
        x, y = (np.where(nowhere, -1, each).astype(np.float32) for each in (u, v))
        gap = np.maximum(depth - _sample(near, x, y), _sample(far, x, y) - depth) / depth
        border = np.minimum(np.minimum(x, width - 1 - x), np.minimum(y, height - 1 - y)) + 0.5
        # Below 0 where the other picture is a mirror's: it shows the surface from behind.
        spans = np.gradient(x, axis=1) * np.gradient(y, axis=0)
        spans -= np.gradient(x, axis=0) * np.gradient(y, axis=1)
        share = (
            _ramp(gap, ANOTHER, SAME)
            * _ramp(border, BORDER, INSIDE)
            * _ramp(spans, TOO_COARSE, FINE_ENOUGH)
        )
    return np.where(nowhere | ~np.isfinite(share), 0, share).astype(np.float32), x, y


def _ramp(values: NDArray[np.floating], none: float, full: float) -> NDArray[np.floating]:
    """0 at `none`, 1 at `full`, between them on a line."""
    return np.clip((values - none) / (full - none), 0, 1)


def _sample(picture: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """A picture's values at (H, W) places: cubic for colours, which linear would blur."""
    import cv2

    how = cv2.INTER_CUBIC if picture.ndim == 3 else cv2.INTER_LINEAR
    sampled = cv2.remap(np.ascontiguousarray(picture), x, y, how, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(sampled, np.float32)
