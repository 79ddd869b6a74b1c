"""What one point map says: how well a camera explains it, and the focal length it was seen with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera

# A point is an inlier within 1 % of the frame's longer side (2.6 pixels at 256): DUSt3R's 5 pixels
# at 512, for the poses that it finds with PnP.
INLIER_FRACTION = 0.01
WEISZFELD_ROUNDS = 30  # converges to a thousandth of a pixel well before, outliers or not
SMALLEST_RESIDUAL = (
    1e-9  # at a focal length of 1; keeps the weights 1 / residual finite at an exact fit
)
FEWEST_POINTS = 12
ENOUGH_POINTS = 16384  # every so many-th of larger maps; one number needs no more
WIDE_FRACTION = 0.04  # for poor point maps, of which hardly any point is within 1 %
LEAST_AGREEMENT = 0.1  # a pose or a lens that a smaller share of the points supports is no answer
# A focal length on which half the points agree needs no second opinion, and one on which a quarter
# more agree than on the first is better.
CERTAIN, CLEARLY_MORE = 0.5, 1.25
# Focal lengths in units of the longer side that a lens can have: 157 to 3 degrees.
SHORTEST, LONGEST = 0.1, 20.0


def pixel_centres(height: int, width: int) -> NDArray[np.float64]:
    """(H, W, 2): x and y of the pixels' centres, the first at (0.5, 0.5)."""
    y, x = np.mgrid[0:height, 0:width]
    return np.stack([x + 0.5, y + 0.5], axis=-1)


def reprojection_errors(
    points: NDArray[np.floating], pixels: NDArray[np.float64], camera: Camera
) -> NDArray[np.float64]:
    """Distances in pixels between where points project and where they were seen.

    Args:
        points: (P, 3) world frame.
        pixels: (P, 2).
        camera: the view's.

    Returns:
        (P,), infinite for points behind the camera and points that are not finite.
    """
    rotation, translation = camera.extrinsics[:3, :3], camera.extrinsics[:3, 3]
    with np.errstate(all="ignore"):
        x, y, z = rotation @ points.T.astype(np.float64, order="C") + translation[:, None]
        off_x = camera.fx * x / z + camera.cx - pixels[:, 0]
        off_y = camera.fy * y / z + camera.cy - pixels[:, 1]
        errors = np.sqrt(off_x * off_x + off_y * off_y)
        return np.where((z > 0) & np.isfinite(errors), errors, np.inf)


def inlier_ratio(
    points: NDArray[np.float32], opacities: NDArray[np.float32], camera: Camera
) -> float:
    """The opacity-weighted share of a view's points that land within 1 % of their own pixels.

    Args:
        points: (H, W, 3) world frame.
        opacities: (H, W).
        camera: the view's.
    """
    pixels = pixel_centres(camera.height, camera.width).reshape(-1, 2)
    threshold = INLIER_FRACTION * max(camera.width, camera.height)
    inliers = reprojection_errors(points.reshape(-1, 3), pixels, camera) < threshold
    weights = np.nan_to_num(opacities.ravel().astype(np.float64), nan=0.0)
    total = float(weights.sum())
    return float(weights[inliers].sum()) / total if total > 0 else 0.0


def estimate_focal(
    points: NDArray[np.float32], opacities: NDArray[np.float32], camera: Camera
) -> float | None:
    """The focal length fx that best explains a point map in its own camera's frame.

    Minimises the sum of | (pixel - principal point) / f - (X/Z, Y/Z) |, not squared, so that
    outliers count little, by Weiszfeld's iteratively reweighted least squares. DUSt3R (arXiv
    2312.14132, section 3.3) minimises f times these residuals; leaving the factor out keeps points
    near the image plane, whose X/Z is huge, from pulling f towards 0. Where most points disagree
    with that, the focal length on which most agree is taken, if those are clearly more.

    Args:
        points: (H, W, 3) in the frame of the camera that saw them.
        opacities: (H, W) weights.
        camera: gives the principal point and the ratio fy / fx.

    Returns:
        Pixels; None where too few points are in front of the camera, or no lens fits a tenth.
    """
    flat = points.reshape(-1, 3).astype(np.float64)
    centre = np.array([camera.cx, camera.cy])
    pixels = pixel_centres(camera.height, camera.width).reshape(-1, 2) - centre
    usable = np.isfinite(flat).all(axis=1) & (flat[:, 2] > 0) & (opacities.ravel() > 0)
    if usable.sum() < FEWEST_POINTS:
        return None
    kept = np.flatnonzero(usable)
    kept = kept[:: -(-len(kept) // ENOUGH_POINTS)]
    weights = opacities.ravel()[kept].astype(np.float64)
    rays, pixels = flat[kept, :2] / flat[kept, 2:], pixels[kept] * [1, camera.fx / camera.fy]
    longer = max(camera.width, camera.height)
    inverse = _least_distances(rays, pixels, weights)
    share = _agreement(rays, pixels, weights, inverse, INLIER_FRACTION * longer)
    if share < CERTAIN:
        other = _consensus(rays, pixels, weights, INLIER_FRACTION * longer)
        agreement = _agreement(rays, pixels, weights, other, INLIER_FRACTION * longer)
        if agreement > CLEARLY_MORE * share:
            inverse = other
        wide = _agreement(rays, pixels, weights, inverse, WIDE_FRACTION * longer)
        if wide < LEAST_AGREEMENT:
            return None
    focal = 1 / inverse if inverse > 0 else 0.0
    return focal if SHORTEST <= focal / longer <= LONGEST else None


def _least_distances(
    rays: NDArray[np.float64], pixels: NDArray[np.float64], weights: NDArray[np.float64]
) -> float:
    """The inverse focal length that minimises the sum of distances; see `estimate_focal`."""
    along, across = (rays * pixels).sum(axis=1), (pixels * pixels).sum(axis=1)
    # The pixels' own answers' median is close enough to start from.
    inverse = float(np.median(along[across > 0] / across[across > 0]))
    for _ in range(WEISZFELD_ROUNDS):
        residuals = np.linalg.norm(rays - inverse * pixels, axis=1)
        robust = weights / np.maximum(residuals, SMALLEST_RESIDUAL)
        inverse = float((robust * along).sum() / (robust * across).sum())
    return inverse


def _consensus(
    rays: NDArray[np.float64],
    pixels: NDArray[np.float64],
    weights: NDArray[np.float64],
    threshold: float,
) -> float:
    """The inverse focal length that most points agree with to `threshold` pixels; 0 for none.

    Each point agrees with an interval of them, between the roots of a quadratic equation; where
    most intervals overlap is found by sorting their ends. Refined on the points that agree.
    """
    quadratic = (pixels * pixels).sum(axis=1) - threshold**2
    linear, constant = (rays * pixels).sum(axis=1), (rays * rays).sum(axis=1)
    discriminant = linear**2 - quadratic * constant
    # Pixels next to the principal point agree with everything and say nothing.
    telling = (quadratic > 0) & (linear > 0) & (discriminant >= 0)
    if not telling.any():
        return 0.0
    root, middle, scale = (
        values[telling] for values in (np.sqrt(discriminant.clip(0)), linear, quadratic)
    )
    ends = np.concatenate([(middle - root) / scale, (middle + root) / scale])
    order = np.argsort(ends, kind="stable")
    support = np.cumsum(np.concatenate([weights[telling], -weights[telling]])[order])
    best = int(np.argmax(support[:-1]))
    inverse = float(ends[order[best : best + 2]].mean())
    agree = np.linalg.norm(rays - inverse * pixels, axis=1) < threshold * inverse
    return _least_distances(rays[agree], pixels[agree], weights[agree])


def _agreement(
    rays: NDArray[np.float64],
    pixels: NDArray[np.float64],
    weights: NDArray[np.float64],
    inverse: float,
    threshold: float,
) -> float:
    """The share of points within `threshold` pixels of their own, by weight."""
    agree = np.linalg.norm(rays - inverse * pixels, axis=1) < threshold * inverse
    return float(weights[agree].sum() / weights.sum())
