"""Views' pictures brought to agree in exposure and tint, where they show one surface."""

from __future__ import annotations

import numpy as np

from styl3r_cli.gaussians import FloatArray
from styl3r_cli.overlaps import Overlaps

# What is coarser than the last of these differs between photos of one surface by exposure, white
# balance and vignetting (between paintings of it by what else the views show): standard deviations
# in pixels, from the coarsest on. With 6 at last or 24, novel views' LPIPS is the same.
SPREADS = (48.0, 24.0, 12.0)
# What the next coarser one weighs where little is shared; far from all that is, nothing changes.
ABSENCE = 0.05


def harmonised(pictures: FloatArray, overlaps: Overlaps) -> FloatArray:
    """The views' pictures without steps from one to the next.

    A phone exposes every photo anew. Drawn from Gaussians of several views, a wall then has spots;
    and colours that are fitted to all views' photos have contours, where two wishes for one surface
    begin and end. Here every view is shifted, smoothly, to what views before it show of the
    same surfaces; then all by one colour, so that on average they are as light as before.

    Args:
        pictures: (N, H, W, 3) in [0, 1].
        overlaps: of the views' scene.

    Returns:
        (N, H, W, 3) in [0, 1].
    """
    made, shifts = pictures.copy(), [np.zeros(3, np.float32)]
    for view in overlaps.order[1:]:
        target, share = overlaps.taken_over(made, view)
        if share.any():
            shift = _smooth(target - share[..., None] * made[view], share)
            made[view] += shift
            if overlaps.visible[view]:
                shifts.append(shift.mean((0, 1)))
    common = np.sum(shifts, axis=0) / max(len(overlaps.order), 1)
    return np.clip(made - common, 0, 1)


def _smooth(differences: FloatArray, share: FloatArray) -> FloatArray:
    """(H, W, 3) differences, known to (H, W) shares, without what is finer than SPREADS."""
    import cv2

    smooth = np.zeros_like(differences)
    for spread in SPREADS:
        there = np.asarray(cv2.GaussianBlur(differences, (0, 0), spread))
        weight = np.asarray(cv2.GaussianBlur(share, (0, 0), spread))[..., None]
        smooth = (there + np.float32(ABSENCE) * smooth) / (weight + np.float32(ABSENCE))
    return smooth
