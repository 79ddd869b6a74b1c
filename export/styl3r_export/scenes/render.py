"""One view of a scene: linear colour, exact depth and sky mask, with 2x2 samples at edges."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from styl3r_export.scenes.builder import Scene
from styl3r_export.scenes.lighting import LightMaps
from styl3r_export.scenes.noise import noise_volume
from styl3r_export.scenes.shading import material_table, shade
from styl3r_export.scenes.visibility import edge_planes, first_hits, to_camera

#: Samples of one part whose inverse depths differ by less than this share are one surface.
SAME_SURFACE = 0.03


@njit(cache=True, nogil=True, fastmath=True)
def _sample(
    t: int, x: float, y: float, pixel: float, camera: NDArray[np.float32],
    vertices: NDArray[np.float32], normals: NDArray[np.float32], uvs: NDArray[np.float32],
    material: NDArray[np.float32], eye: NDArray[np.float64], textures: NDArray[np.uint8],
    volume: NDArray[np.float32], lights: tuple, ambient: NDArray[np.float64],
    out: NDArray[np.float64], noise: NDArray[np.float64], planes: NDArray[np.float64],
) -> None:  # fmt: skip
    """Shade triangle t where the ray (x, y, 1) of the camera meets its plane."""
    edge_planes(camera[t], planes)
    weights, total = np.empty(3), 0.0
    for k in range(3):
        weights[k] = planes[k, 0] * x + planes[k, 1] * y + planes[k, 2]
        total += weights[k]
    for k in range(3):  # a pixel's centre may lie just beside the triangle its samples hit
        weights[k] = min(max(weights[k] / total, -0.5), 1.5)
    total = weights[0] + weights[1] + weights[2]
    p, n, uv, view = np.zeros(3), np.zeros(3), np.zeros(2), np.empty(3)
    for k in range(3):
        w = weights[k] / total
        for c in range(3):
            p[c] += w * vertices[t, k, c]
            n[c] += w * normals[t, k, c]
        uv[0] += w * uvs[t, k, 0]
        uv[1] += w * uvs[t, k, 1]
    for c in range(3):
        view[c] = eye[c] - p[c]
    distance = np.sqrt((view * view).sum())
    view /= distance
    a, b = vertices[t, 1] - vertices[t, 0], vertices[t, 2] - vertices[t, 0]
    face = np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )
    slant = (face * view).sum() / np.sqrt((face * face).sum() + 1e-30)
    n /= np.sqrt((n * n).sum() + 1e-30)
    if ((n * face).sum() < 0) != (slant < 0):  # smooth normals follow the side that is seen
        n = -n
    width = pixel * distance / np.sqrt(max(abs(slant), 0.08))
    shade(material, p, n, uv, view, width, textures, volume, lights, ambient, out, noise)


@njit(cache=True, nogil=True, fastmath=True)
def _resolve(
    hits: NDArray[np.int32], inverse: NDArray[np.float32], lens: tuple,
    camera: NDArray[np.float32], vertices: NDArray[np.float32], normals: NDArray[np.float32],
    uvs: NDArray[np.float32], parts: NDArray[np.int32], materials: NDArray[np.float32],
    eye: NDArray[np.float64], textures: NDArray[np.uint8], volume: NDArray[np.float32],
    lights: tuple, ambient: NDArray[np.float64], image: NDArray[np.float32],
) -> None:  # fmt: skip
    """Colours from a 2x2 finer hit buffer: one sample inside surfaces, four at edges."""
    fx, fy, cx, cy = lens
    height, width = image.shape[:2]
    out, total, noise = np.empty(3), np.empty(3), np.empty(4)
    planes = np.empty((3, 3))
    for i in range(height):
        for j in range(width):
            first = hits[2 * i, 2 * j]
            low, high, smooth = 1e30, 0.0, first >= 0
            for s in range(4):
                t, z = hits[2 * i + s // 2, 2 * j + s % 2], inverse[2 * i + s // 2, 2 * j + s % 2]
                low, high = min(low, z), max(high, z)
                smooth = smooth and t >= 0 and parts[t] == parts[first]
            smooth = smooth and high - low < SAME_SURFACE * high
            total[:] = 0.0
            for s in range(1 if smooth else 4):
                ii, jj = 2 * i + s // 2, 2 * j + s % 2
                t = hits[ii, jj]
                if t < 0:
                    continue
                x = (j + 0.5 - cx) / fx if smooth else ((jj + 0.5) / 2 - cx) / fx
                y = (i + 0.5 - cy) / fy if smooth else ((ii + 0.5) / 2 - cy) / fy
                _sample(
                    t, x, y, 1.0 / fx, camera, vertices, normals, uvs, materials[parts[t]], eye,
                    textures, volume, lights, ambient, out, noise, planes,
                )  # fmt: skip
                total += out
            image[i, j] = total if smooth else total / 4


def render(
    scene: Scene,
    lights: LightMaps,
    extrinsics: NDArray[np.float64],
    intrinsics: tuple[float, float, float, float],
    size: tuple[int, int],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
    """Cast one view.

    Args:
        scene: the scene.
        lights: its shadow maps.
        extrinsics: (4, 4) world-to-camera.
        intrinsics: fx, fy, cx, cy in pixels.
        size: height and width.

    Returns:
        Linear RGB (H, W, 3); camera z depth of the pixel centres (H, W), inf where nothing is
        hit; index of the part seen there (H, W), -1 for nothing.
    """
    height, width = size
    camera = to_camera(scene.vertices, extrinsics)
    inverse = np.empty((height, width), np.float32)
    hits = np.empty((height, width), np.int32)
    first_hits(camera, intrinsics, inverse, hits)
    fine_inverse = np.empty((2 * height, 2 * width), np.float32)
    fine_hits = np.empty((2 * height, 2 * width), np.int32)
    fine = tuple(2.0 * v for v in intrinsics)
    first_hits(camera, fine, fine_inverse, fine_hits)
    image = np.empty((height, width, 3), np.float32)
    eye = -extrinsics[:3, :3].T @ extrinsics[:3, 3]
    fields = tuple(vars(lights).values())
    occupancy = lights.occupancy[..., None]
    _resolve(
        fine_hits, fine_inverse, tuple(float(v) for v in intrinsics), camera, scene.vertices,
        scene.normals, scene.uvs, scene.parts, material_table(scene.materials), eye,
        scene.textures, noise_volume(), (*fields[:5], occupancy, *fields[6:]), scene.ambient, image,
    )  # fmt: skip
    with np.errstate(divide="ignore"):
        depth = np.where(hits >= 0, 1 / inverse, np.inf).astype(np.float32)
    return image, depth, np.where(hits >= 0, scene.parts[np.maximum(hits, 0)], -1)
