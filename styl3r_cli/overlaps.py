"""Which pixels of the views show one surface, so that it is painted, and kept, once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.gaussians import FloatArray
from styl3r_cli.meetings import Ground, sample
from styl3r_cli.pipeline import Scene

# A pixel's Gaussian is a repeat if of the BAND x BAND pixels around it less than this share is the
# view's own: where views meet, both are kept for a few pixels, or their seam shows.
BAND, OWN_SHARE = 5, 0.2
MOSTLY = 0.5  # a share beyond which a pixel is the other view's
# A Gaussian that two other views look through is not there, unless others see it too: it takes
# three more for each of these. With one for each, thin things go that are right (novel views of
# eight photos lose 0.3 dB); if none may see it, what hangs before a surface stays.
ALLOWED_DOUBTS, DOUBTS_PER_WITNESS = 1, 3
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
        kept: (N, H, W), whether the pixel's Gaussian is needed: not if it repeats another view's,
            nor if other views see through it.
        visible: (N,), whether any Gaussian of the view is to be seen.

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
        self.overlaps: list[Overlap] = []
        self.own = np.ones(scene.means.shape[:3], np.float32)
        doubts = np.zeros(scene.means.shape[:3], np.float32)
        # What is never drawn stands for nothing.
        drawn = np.where((scene.opacities > 0)[..., None], scene.means, np.nan)
        grounds = {view: Ground.of(drawn[view], recovered.cameras[view]) for view in known}
        for index, view in enumerate(self.order):
            for other in self.order:
                if other == view:
                    continue
                meeting = grounds[other].meet(scene.means[view])
                doubts[view] += meeting.through - DOUBTS_PER_WITNESS * meeting.agrees
                if other in self.order[:index]:
                    share = meeting.share()
                    self.overlaps.append(Overlap(view, other, share, meeting.x, meeting.y))
                    self.own[view] *= 1 - share
        self.kept = doubts <= ALLOWED_DOUBTS
        for view in self.order:
            around = cv2.blur(self.own[view], (BAND, BAND))
            self.kept[view] &= (around > OWN_SHARE) | ~self._stood_for(view)
        self.visible = np.any(scene.opacities > 0, axis=(1, 2))

    def _stood_for(self, view: int) -> NDArray[np.bool_]:
        """(H, W), whether what a view repeats is kept there: it may be left out itself."""
        import cv2

        stands = np.zeros(self.own.shape[1:], np.uint8)
        for each in self.overlaps:
            if each.view == view:
                there = sample(self.kept[each.painter].astype(np.float32), each.x, each.y)
                stands |= ((each.share > 0) & (there > 0)).astype(np.uint8)
        return np.asarray(cv2.dilate(stands, np.ones((BAND, BAND), np.uint8))) > 0

    def paint_once(self, pictures: FloatArray, strength: float = 1.0) -> FloatArray:
        """The views' pictures with each surface as the first view in order painted it.

        Args:
            pictures: (N, H, W, 3), each view painted for itself.
            strength: how much of what another view painted is taken over, 0 to 1.

        Returns:
            (N, H, W, 3).
        """
        painted = pictures.copy()
        for view in self.order[1:]:
            target, share = self.taken_over(pictures, view)
            change = target - share[..., None] * pictures[view]
            painted[view] += np.float32(strength) * change
        return painted

    def taken_over(self, pictures: FloatArray, view: int) -> tuple[FloatArray, FloatArray]:
        """What earlier views show of a view's surfaces.

        Args:
            pictures: (N, H, W, 3).
            view: index of the view.

        Returns:
            (H, W, 3), times (H, W) how much of each pixel it is.
        """
        target = np.zeros(pictures.shape[1:], np.float32)
        left = np.ones(pictures.shape[1:3], np.float32)
        for each in self.overlaps:  # the earliest painter first
            if each.view == view:
                taken = left * each.share
                target += taken[..., None] * sample(pictures[each.painter], each.x, each.y)
                left -= taken
        return target, 1 - left

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
