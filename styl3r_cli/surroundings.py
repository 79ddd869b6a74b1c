"""What a frame shows where the scene has nothing: the colours around, blurred into the hole."""

from __future__ import annotations

import numpy as np

from styl3r_cli.gaussians import FloatArray

# A level that is covered by less than this says nothing of its colour.
LEAST_COVER = 1e-6


def fill_holes(colour: FloatArray, alpha: FloatArray) -> FloatArray:
    """Put a frame over a blurred continuation of itself.

    Pull-push (Gortler et al., The Lumigraph, SIGGRAPH 1996): the frame is halved down to a pixel,
    weighted by coverage, and each level is laid over the enlarged next one. Holes get the colours
    of their rims, the smoother the larger they are; what the scene covers stays as it is.

    Args:
        colour: (H, W, 3) weighted by alpha, on black.
        alpha: (H, W) in [0, 1].

    Returns:
        (H, W, 3); black where the whole frame is empty.
    """
    import cv2

    levels = [(np.asarray(colour, np.float32), np.asarray(alpha, np.float32))]
    while max(levels[-1][1].shape) > 1:
        size = tuple((side + 1) // 2 for side in reversed(levels[-1][1].shape))
        halved = [cv2.resize(part, size, interpolation=cv2.INTER_AREA) for part in levels[-1]]
        levels.append((np.asarray(halved[0], np.float32), np.asarray(halved[1], np.float32)))
    last, cover = levels.pop()
    below = last / max(float(cover.max()), LEAST_COVER)
    below = np.asarray(below, np.float32).reshape(1, 1, 3)
    for part, cover in reversed(levels):
        size = tuple(reversed(cover.shape))
        above = cv2.resize(below, size, interpolation=cv2.INTER_LINEAR)
        below = part + (1 - cover[..., None]) * above.reshape(*cover.shape, 3)
    return below
