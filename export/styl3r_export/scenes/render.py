"""One view of a scene: linear colour, exact depth and parts, with 2x2 samples at edges."""

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.splatting.compiler import kernel
from styl3r_export.scenes.builder import Scene
from styl3r_export.scenes.lighting import LightMaps
from styl3r_export.scenes.noise import noise_volume
from styl3r_export.scenes.shading import shade
from styl3r_export.scenes.surface_colour import Vector, material_table
from styl3r_export.scenes.visibility import edge_planes, first_hits, to_camera

#: Samples of one part whose inverse depths differ by less than this share are one surface.
SAME_SURFACE = 0.03
#: Slant (cosine) below which a pixel's footprint grows no further: keeps grazing floors crisp.
GRAZING = 0.08

#: fx, fy, cx, cy in pixels.
Lens = tuple[float, float, float, float]


@kernel
def _sample(
    t: int, x: float, y: float, pixel: float, camera: NDArray[np.float32],
    geometry: tuple, material: NDArray[np.float32], eye: NDArray[np.float64], looks: tuple,
    planes: NDArray[np.float64],
) -> Vector:  # fmt: skip
    """Shade triangle t where the ray (x, y, 1) of the camera meets its plane."""
    vertices, normals, uvs = geometry[0][t], geometry[1][t], geometry[2][t]
    edge_planes(camera[t], planes)
    a = planes[0, 0] * x + planes[0, 1] * y + planes[0, 2]
    b = planes[1, 0] * x + planes[1, 1] * y + planes[1, 2]
    c = planes[2, 0] * x + planes[2, 1] * y + planes[2, 2]
    total = a + b + c  # a pixel's centre may lie just beside the triangle its samples hit
    a, b = min(max(a / total, -0.5), 1.5), min(max(b / total, -0.5), 1.5)
    c = 1.0 - a - b
    px = a * vertices[0, 0] + b * vertices[1, 0] + c * vertices[2, 0]
    py = a * vertices[0, 1] + b * vertices[1, 1] + c * vertices[2, 1]
    pz = a * vertices[0, 2] + b * vertices[1, 2] + c * vertices[2, 2]
    nx = a * normals[0, 0] + b * normals[1, 0] + c * normals[2, 0]
    ny = a * normals[0, 1] + b * normals[1, 1] + c * normals[2, 1]
    nz = a * normals[0, 2] + b * normals[1, 2] + c * normals[2, 2]
    u = a * uvs[0, 0] + b * uvs[1, 0] + c * uvs[2, 0]
    v = a * uvs[0, 1] + b * uvs[1, 1] + c * uvs[2, 1]
    vx, vy, vz = eye[0] - px, eye[1] - py, eye[2] - pz
    distance = np.sqrt(vx * vx + vy * vy + vz * vz)
    vx, vy, vz = vx / distance, vy / distance, vz / distance
    ex, ey, ez = (
        vertices[1, 0] - vertices[0, 0],
        vertices[1, 1] - vertices[0, 1],
        vertices[1, 2] - vertices[0, 2],
    )
    gx, gy, gz = (
        vertices[2, 0] - vertices[0, 0],
        vertices[2, 1] - vertices[0, 1],
        vertices[2, 2] - vertices[0, 2],
    )
    fx, fy, fz = ey * gz - ez * gy, ez * gx - ex * gz, ex * gy - ey * gx
    slant = (fx * vx + fy * vy + fz * vz) / np.sqrt(fx * fx + fy * fy + fz * fz + 1e-30)
    length = np.sqrt(nx * nx + ny * ny + nz * nz + 1e-30)
    if (nx * fx + ny * fy + nz * fz < 0) != (slant < 0):  # normals follow the side that is seen
        length = -length
    width = pixel * distance / np.sqrt(max(abs(slant), GRAZING))
    return shade(
        material, (px, py, pz), (nx / length, ny / length, nz / length), (u, v), (vx, vy, vz),
        width, looks[0], looks[1], looks[2], looks[3],
    )  # fmt: skip


@kernel
def _resolve(
    hits: NDArray[np.int32], inverse: NDArray[np.float32], lens: Lens,
    camera: NDArray[np.float32], geometry: tuple, materials: NDArray[np.float32],
    eye: NDArray[np.float64], looks: tuple, image: NDArray[np.float32],
) -> None:  # fmt: skip
    """Colours from a 2x2 finer hit buffer: each surface in a pixel is shaded once."""
    fx, fy, cx, cy = lens
    parts = geometry[3]
    planes = np.empty((3, 3))
    for i in range(image.shape[0]):
        for j in range(image.shape[1]):
            red, green, blue, done = 0.0, 0.0, 0.0, 0
            for s in range(4):
                if done >> s & 1:
                    continue
                t, near = (
                    hits[2 * i + s // 2, 2 * j + s % 2],
                    inverse[2 * i + s // 2, 2 * j + s % 2],
                )
                if t < 0:
                    continue
                x, y, same = 0.0, 0.0, 0
                for q in range(s, 4):  # other samples on the same surface
                    ii, jj = 2 * i + q // 2, 2 * j + q % 2
                    other = hits[ii, jj]
                    if (
                        other >= 0
                        and not done >> q & 1
                        and parts[other] == parts[t]
                        and abs(inverse[ii, jj] - near) < SAME_SURFACE * near
                    ):
                        done |= 1 << q
                        same += 1
                        x, y = x + (jj + 0.5) / 2, y + (ii + 0.5) / 2
                x, y = (x / same - cx) / fx, (y / same - cy) / fy
                r, g, b = _sample(
                    t, x, y, 1.0 / fx, camera, geometry, materials[parts[t]], eye, looks, planes
                )
                red, green, blue = red + same * r, green + same * g, blue + same * b
            image[i, j, 0], image[i, j, 1], image[i, j, 2] = red / 4, green / 4, blue / 4


def render(
    scene: Scene,
    lights: LightMaps,
    extrinsics: NDArray[np.float64],
    lens: Lens,
    size: tuple[int, int],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
    """Cast one view.

    Args:
        scene: the scene.
        lights: its shadow maps.
        extrinsics: (4, 4) world-to-camera.
        lens: fx, fy, cx, cy in pixels.
        size: height and width.

    Returns:
        Linear RGB (H, W, 3); camera z depth of the pixel centres (H, W), inf where nothing is
        hit; index of the part seen there (H, W), -1 for nothing.
    """
    height, width = size
    camera = to_camera(scene.vertices, extrinsics)
    inverse = np.empty((height, width), np.float32)
    hits = np.empty((height, width), np.int32)
    first_hits(camera, lens, inverse, hits)
    fine_inverse = np.empty((2 * height, 2 * width), np.float32)
    fine_hits = np.empty((2 * height, 2 * width), np.int32)
    fx, fy, cx, cy = lens
    first_hits(camera, (2 * fx, 2 * fy, 2 * cx, 2 * cy), fine_inverse, fine_hits)
    image = np.empty((height, width, 3), np.float32)
    eye = -extrinsics[:3, :3].T @ extrinsics[:3, 3]
    looks = (scene.textures, noise_volume(), tuple(vars(lights).values()), scene.ambient)
    geometry = (scene.vertices, scene.normals, scene.uvs, scene.parts)
    table = material_table(scene.materials)
    _resolve(fine_hits, fine_inverse, lens, camera, geometry, table, eye, looks, image)
    with np.errstate(divide="ignore"):
        depth = np.where(hits >= 0, 1 / inverse, np.inf).astype(np.float32)
    return image, depth, np.where(hits >= 0, scene.parts[np.maximum(hits, 0)], -1)
