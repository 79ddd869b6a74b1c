"""First hits of camera rays in a triangle soup: exact ray casting, bounded by screen rectangles."""

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.splatting.compiler import kernel

#: Hits closer than this (scene units, about metres) are inside the lens and do not count.
NEAR = 0.02
#: A triangle whose plane passes this close to the eye (signed volume) is seen edge-on: no pixels.
EDGE_ON = 1e-13


@kernel
def _screen_bounds(
    triangle: NDArray[np.float32], fx: float, fy: float, cx: float, cy: float
) -> tuple[float, float, float, float]:
    """Pixel rectangle of the part of a triangle in front of the lens (empty: low > high)."""
    low_x, low_y, high_x, high_y = 1e9, 1e9, -1e9, -1e9
    for k in range(3):
        ax, ay, az = triangle[k, 0], triangle[k, 1], triangle[k, 2]
        m = (k + 1) % 3
        bx, by, bz = triangle[m, 0], triangle[m, 1], triangle[m, 2]
        if az >= NEAR:
            u, v = fx * ax / az + cx, fy * ay / az + cy
            low_x, high_x = min(low_x, u), max(high_x, u)
            low_y, high_y = min(low_y, v), max(high_y, v)
        if (az < NEAR) != (bz < NEAR):  # the edge leaves through the near plane
            s = (NEAR - az) / (bz - az)
            u = fx * (ax + s * (bx - ax)) / NEAR + cx
            v = fy * (ay + s * (by - ay)) / NEAR + cy
            low_x, high_x = min(low_x, u), max(high_x, u)
            low_y, high_y = min(low_y, v), max(high_y, v)
    return low_x, low_y, high_x, high_y


@kernel
def edge_planes(triangle: NDArray[np.float32], planes: NDArray[np.float64]) -> float:
    """Planes through the eye and each edge; a ray's barycentrics are its products with them.

    Args:
        triangle: (3, 3) corners in the camera frame.
        planes: (3, 3) output; row k dotted with a ray direction is k's unnormalised weight.

    Returns:
        Six times the signed volume of eye and triangle; depth is it over the sum of weights.
    """
    for k in range(3):
        a, b = triangle[(k + 1) % 3], triangle[(k + 2) % 3]
        ax, ay, az = float(a[0]), float(a[1]), float(a[2])
        bx, by, bz = float(b[0]), float(b[1]), float(b[2])
        planes[k, 0] = ay * bz - az * by
        planes[k, 1] = az * bx - ax * bz
        planes[k, 2] = ax * by - ay * bx
    return (
        triangle[0, 0] * planes[0, 0]
        + triangle[0, 1] * planes[0, 1]
        + triangle[0, 2] * planes[0, 2]
    )


@kernel
def first_hits(
    triangles: NDArray[np.float32],
    intrinsics: tuple[float, float, float, float],
    inverse_depth: NDArray[np.float32],
    hits: NDArray[np.int32],
) -> None:
    """For each pixel centre's ray, the nearest triangle and its inverse camera depth.

    Args:
        triangles: (T, 3, 3) corners in the camera frame (x right, y down, z forward).
        intrinsics: fx, fy, cx, cy in pixels; the first pixel's centre is (0.5, 0.5).
        inverse_depth: (H, W) output, 0 where nothing is hit.
        hits: (H, W) output, triangle index, -1 where nothing is hit.
    """
    fx, fy, cx, cy = intrinsics
    height, width = inverse_depth.shape
    inverse_depth[:] = 0.0
    hits[:] = -1
    planes = np.empty((3, 3), np.float64)
    for t in range(triangles.shape[0]):
        low_x, low_y, high_x, high_y = _screen_bounds(triangles[t], fx, fy, cx, cy)
        if high_x < 0.5 or high_y < 0.5 or low_x > width - 0.5 or low_y > height - 0.5:
            continue
        x0, x1 = int(max(low_x - 0.5, 0.0)), int(min(high_x + 0.5, width - 1.0))
        y0, y1 = int(max(low_y - 0.5, 0.0)), int(min(high_y + 0.5, height - 1.0))
        volume = edge_planes(triangles[t], planes)
        if abs(volume) < EDGE_ON:
            continue
        a0, a1, a2 = planes[0, 0] / volume, planes[1, 0] / volume, planes[2, 0] / volume
        b0, b1, b2 = planes[0, 1] / volume, planes[1, 1] / volume, planes[2, 1] / volume
        c0, c1, c2 = planes[0, 2] / volume, planes[1, 2] / volume, planes[2, 2] / volume
        for i in range(y0, y1 + 1):
            y = (i + 0.5 - cy) / fy
            r0, r1, r2 = b0 * y + c0, b1 * y + c1, b2 * y + c2
            for j in range(x0, x1 + 1):
                x = (j + 0.5 - cx) / fx
                w0, w1, w2 = a0 * x + r0, a1 * x + r1, a2 * x + r2
                if w0 >= 0.0 and w1 >= 0.0 and w2 >= 0.0:
                    inverse = w0 + w1 + w2
                    if inverse > inverse_depth[i, j] and inverse * NEAR < 1.0:
                        inverse_depth[i, j] = inverse
                        hits[i, j] = t


def to_camera(points: NDArray[np.float32], extrinsics: NDArray[np.float64]) -> NDArray[np.float32]:
    """World points (..., 3) in the frame of a world-to-camera 4x4."""
    rotation = extrinsics[:3, :3]
    eye = -rotation.T @ extrinsics[:3, 3]
    # Subtracting the eye first keeps float32 exact enough far from the world's origin.
    ahead = (points.reshape(-1, 3) - eye.astype(np.float32)) @ rotation.T.astype(np.float32)
    return ahead.reshape(points.shape)
