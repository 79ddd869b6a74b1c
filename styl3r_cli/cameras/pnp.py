"""One view's pose from its points in the world frame: RANSAC over P3P, then refinement."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.pointmap import (
    INLIER_FRACTION,
    LEAST_AGREEMENT,
    WIDE_FRACTION,
    pixel_centres,
    reprojection_errors,
)

# P3P with 60 % outliers needs 355 samples to be 99.99 % sure; the rest is for worse maps.
SAMPLES, CONFIDENCE = 1000, 0.9999
MOST_POINTS = 8192  # for refinement: beyond, the pose hardly gets better, only slower
STRIDE = 8  # every hypothesis is tested on all its points, so RANSAC gets every 8th
FEWEST_POINTS = 12  # three times what one hypothesis needs; fewer agree by chance
GOOD_AGREEMENT = 0.3  # below, a second search allows the wide threshold
REFINEMENTS = 3  # rounds of Levenberg-Marquardt on the inliers, which then are found anew
FLAT = 1e-4  # points on a line, or in one place, to this relative extent have no pose
FAR = 10.0  # times the median distance: points beyond count as if they were there
SEED = 0  # of the subsampling


def find_pose(
    points: NDArray[np.float32], opacities: NDArray[np.float32], camera: Camera
) -> NDArray[np.float64] | None:
    """World-to-camera of the view whose pixels show these points.

    Args:
        points: (H, W, 3) world frame, one a pixel.
        opacities: (H, W): opaque points are drawn more often.
        camera: the view's intrinsics; its extrinsics are not used.

    Returns:
        (4, 4) rigid, or None where no pose explains enough of the points.
    """
    chosen = _draw(points, opacities)
    if len(chosen) < FEWEST_POINTS * STRIDE:
        return None
    world = points.reshape(-1, 3)[chosen].astype(np.float64)
    pixels = pixel_centres(camera.height, camera.width).reshape(-1, 2)[chosen]
    # Around their own centre and at their own size, so that the solver meets no extreme numbers.
    centre = np.median(world, axis=0)
    distances = np.linalg.norm(world - centre, axis=1)
    size = float(np.median(distances))
    if not size > 0:
        return None
    # Far points count no more than others, or a single one would make all the rest look flat.
    shrunk = (world - centre) / np.maximum(distances, FAR * size)[:, None]
    extents = np.linalg.svd(shrunk, compute_uv=False)
    if extents[1] < FLAT * extents[0]:
        return None
    best, agreement = None, LEAST_AGREEMENT
    for fraction in (INLIER_FRACTION, WIDE_FRACTION):
        threshold = fraction * max(camera.width, camera.height)
        pose = _search((world - centre) / size, pixels, camera, threshold)
        if pose is not None:
            pose[:3, 3] = size * pose[:3, 3] - pose[:3, :3] @ centre
            errors = reprojection_errors(world, pixels, replace(camera, extrinsics=pose))
            share = float((errors < threshold).mean())
            if share > agreement:
                best, agreement = pose, share
        if best is not None and agreement >= GOOD_AGREEMENT:
            break
    return best


def _draw(points: NDArray[np.float32], opacities: NDArray[np.float32]) -> NDArray[np.intp]:
    """Indices of up to MOST_POINTS finite points, drawn by opacity, in pixel order."""
    weights = np.nan_to_num(opacities.ravel().astype(np.float64), nan=0.0).clip(0, 1)
    weights[~np.isfinite(points.reshape(-1, 3)).all(axis=1)] = 0
    candidates = np.flatnonzero(weights)
    if len(candidates) <= MOST_POINTS:
        return candidates
    shares = weights[candidates] / weights[candidates].sum()
    drawn = np.random.default_rng(SEED).choice(candidates, MOST_POINTS, replace=False, p=shares)
    return np.sort(drawn)


def _search(
    points: NDArray[np.float64], pixels: NDArray[np.float64], camera: Camera, threshold: float
) -> NDArray[np.float64] | None:
    """The best pose within a threshold in pixels, refined on its inliers."""
    import cv2

    no_distortion = np.zeros(4)
    try:
        found, rotation, translation, _ = cv2.solvePnPRansac(
            points[::STRIDE],
            pixels[::STRIDE],
            camera.intrinsics,
            no_distortion,
            iterationsCount=SAMPLES,
            reprojectionError=threshold,
            confidence=CONFIDENCE,
            flags=cv2.SOLVEPNP_P3P,
        )
        if not found:
            return None
        for _ in range(REFINEMENTS):
            pose = _pose_matrix(rotation, translation)
            errors = reprojection_errors(points, pixels, replace(camera, extrinsics=pose))
            inliers = errors < threshold
            if inliers.sum() < FEWEST_POINTS:
                return None
            rotation, translation = cv2.solvePnPRefineLM(
                points[inliers],
                pixels[inliers],
                camera.intrinsics,
                no_distortion,
                rotation,
                translation,
            )
    except cv2.error:  # a degenerate sample that OpenCV does not survive
        return None
    pose = _pose_matrix(rotation, translation)
    return pose if np.isfinite(pose).all() else None


def _pose_matrix(rotation: Any, translation: Any) -> NDArray[np.float64]:
    """From OpenCV's rotation vector and translation."""
    import cv2

    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(rotation)[0]
    pose[:3, 3] = np.ravel(translation)
    return pose
