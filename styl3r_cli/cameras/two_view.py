"""Two pictures' motion by features that match: SIFT and an essential matrix, by OpenCV."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

# Of a picture, the strongest: what two of them are compared in takes memory with their square.
# Of 64 real photos of up to 512 pixels, the one that has most has 3,076.
MOST_FEATURES = 4096
LOWE_RATIO = 0.8  # Lowe 2004, section 7.1
THRESHOLD = 1.0  # pixels from the epipolar line
CONFIDENCE = 0.99999
MOST_ROUNDS = 10_000
FEWEST_MATCHES = 5  # that the five-point algorithm needs

Array = NDArray[np.float64]


class Features(NamedTuple):
    """What SIFT finds in a picture.

    Attributes:
        pixels: (F, 2) positions; the first pixel's centre is at (0.5, 0.5).
        descriptors: (F, 128), or None where it finds nothing.
    """

    pixels: Array
    descriptors: NDArray[np.float32] | None


def features(picture: NDArray[np.uint8]) -> Features:
    """SIFT features of an (H, W, 3) RGB picture."""
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    keys, found = cv2.SIFT.create(MOST_FEATURES).detectAndCompute(grey, None)
    descriptors = None if found is None else np.asarray(found, np.float32)
    # OpenCV puts the first pixel's centre at (0, 0), this project at (0.5, 0.5).
    pixels = np.array([key.pt for key in keys]).reshape(-1, 2) + 0.5
    return Features(pixels, descriptors)


def match(first: Features, second: Features) -> tuple[Array, Array]:
    """(M, 2) pixel positions of the mutually best matches that pass the ratio test.

    SIFT's descriptors are whole numbers up to 255: their distances' squares are exact in float32,
    in whatever order they are summed.
    """
    empty = np.zeros((0, 2))
    a, b = first.descriptors, second.descriptors
    if a is None or b is None or len(a) < 2 or len(b) < 2:
        return empty, empty
    apart = a @ b.T
    apart *= -2
    apart += np.square(a).sum(1)[:, None]
    apart += np.square(b).sum(1)
    rows, best, nearest = np.arange(len(a)), apart.argmin(1), apart.min(0)
    least = apart[rows, best]
    apart[rows, best] = np.inf
    good = np.flatnonzero((least < LOWE_RATIO**2 * apart.min(1)) & (least == nearest[best]))
    _, once = np.unique(best[good], return_index=True)  # of equally near ones the first
    good = good[np.sort(once)]
    return first.pixels[good], second.pixels[best[good]]


def relative_pose(
    first: NDArray[np.uint8], second: NDArray[np.uint8], first_k: Array, second_k: Array
) -> Array | None:
    """The second camera relative to the first: (4, 4), translation of length 1.

    Args:
        first: (H, W, 3) RGB.
        second: (H, W, 3) RGB.
        first_k: (3, 3) intrinsics in pixels.
        second_k: the second picture's.

    Returns:
        None where there are too few matches.
    """
    return solve(*match(features(first), features(second)), first_k, second_k)


def solve(a: Array, b: Array, first_k: Array, second_k: Array) -> Array | None:
    """The second camera relative to the first, from matching pixel positions (M, 2).

    Returns:
        (4, 4), translation of length 1; None where there are too few matches.
    """
    if len(a) < FEWEST_MATCHES:
        return None
    rays_a, rays_b = (rays(uv, k)[:, :2] for uv, k in ((a, first_k), (b, second_k)))
    focal = float(np.mean([first_k[0, 0], first_k[1, 1], second_k[0, 0], second_k[1, 1]]))
    cv2.setRNGSeed(0)
    matrices, mask = cv2.findEssentialMat(
        rays_a, rays_b, np.eye(3), cv2.RANSAC, CONFIDENCE, THRESHOLD / focal, MOST_ROUNDS
    )
    if matrices is None:
        return None
    best, most = None, 0
    for matrix in np.split(matrices, len(matrices) // 3):  # some point sets allow several
        count, rotation, translation, _ = cv2.recoverPose(
            matrix, rays_a, rays_b, np.eye(3), mask=mask.copy()
        )
        if count > most:
            best, most = np.eye(4), count
            best[:3, :3], best[:3, 3] = rotation, translation[:, 0]
    return best


def rays(pixels: Array, k: Array) -> Array:
    """(M, 3) directions of pixels in their camera's frame, z = 1, by its (3, 3) intrinsics."""
    flat = (pixels - k[:2, 2]) / np.array([k[0, 0], k[1, 1]])
    return np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
