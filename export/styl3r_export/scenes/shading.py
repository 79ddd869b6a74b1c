"""Colour of a surface point: texture, noise, lights with soft shadows, contact darkening."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from styl3r_export.scenes.builder import Material
from styl3r_export.scenes.lighting import GRID_BLUR, SHADOW_SIDE
from styl3r_export.scenes.noise import VOLUME_CELLS
from styl3r_export.scenes.patterns import SIDE
from styl3r_export.scenes.textures import LEVELS

#: Occupancy read GRID_BLUR cells above a lone flat surface: no occlusion up to here.
LONE = 0.20
#: How fast surplus occupancy darkens ambient light (1: a crowded cell halves it).
CROWD = 2.2
#: Reflection of a smooth dielectric looked at straight on.
FRESNEL = 0.04
#: Offsets of the shadow taps: a sunflower disc of 12.
TAPS = 12
_turns = np.arange(TAPS) * 2.399963
_reach = np.sqrt((np.arange(TAPS) + 0.5) / TAPS)
DISC = np.stack([_reach * np.cos(_turns), _reach * np.sin(_turns)], 1).astype(np.float32)

_codes = np.arange(256) / 255
#: Linear value of each 8-bit sRGB code.
LINEAR = np.where(_codes <= 0.04045, _codes / 12.92, ((_codes + 0.055) / 1.055) ** 2.4).astype(
    np.float32
)


def material_table(materials: list[Material]) -> NDArray[np.float32]:
    """(M, 14) rows in the order the kernels read them."""
    return np.array(
        [
            [
                *m.tint, m.texture, m.scale, m.triplanar, m.mirrored, m.gloss, m.sharpness,
                m.stain, m.stain_scale, m.bump, m.bump_scale, m.glow,
            ]
            for m in materials
        ],
        np.float32,
    )  # fmt: skip


@njit(cache=True, nogil=True, fastmath=True)
def _texel(
    pyramid: NDArray[np.uint8], start: int, side: int, u: float, v: float, mirrored: bool,
    weight: float, out: NDArray[np.float64],
) -> None:  # fmt: skip
    """Add weight times the bilinear sample of one level at (u, v) in texture lengths."""
    x, y = u * side - 0.5, v * side - 0.5
    fx, fy = np.floor(x), np.floor(y)
    ax, ay = x - fx, y - fy
    for dy in range(2):
        for dx in range(2):
            i, j = int(fy) + dy, int(fx) + dx
            if mirrored:
                i, j = i % (2 * side), j % (2 * side)
                i = 2 * side - 1 - i if i >= side else i
                j = 2 * side - 1 - j if j >= side else j
            else:
                i, j = i % side, j % side
            w = weight * (ax if dx else 1 - ax) * (ay if dy else 1 - ay)
            at = start + i * side + j
            for k in range(3):
                out[k] += w * LINEAR[pyramid[at, k]]


@njit(cache=True, nogil=True, fastmath=True)
def _texture(
    pyramid: NDArray[np.uint8], u: float, v: float, footprint: float, mirrored: bool,
    weight: float, out: NDArray[np.float64],
) -> None:  # fmt: skip
    """Trilinear sample; footprint is a pixel's width in texture lengths."""
    level = min(max(np.log2(max(footprint * SIDE, 1e-6)), 0.0), LEVELS - 1.0)
    low = int(level)
    part = level - low
    start, side = 0, SIDE
    for _ in range(low):
        start += side * side
        side //= 2
    _texel(pyramid, start, side, u, v, mirrored, weight * (1 - part), out)
    if part > 0.02 and side > 1:
        _texel(pyramid, start + side * side, side // 2, u, v, mirrored, weight * part, out)


@njit(cache=True, nogil=True, fastmath=True)
def _trilinear(
    volume: NDArray[np.float32], x: float, y: float, z: float, wrap: bool, out: NDArray[np.float64]
) -> None:
    """Sample of a (n, n, n, C) volume at cell coordinates, tiled or held at its border."""
    n, channels = volume.shape[0], volume.shape[3]
    fx, fy, fz = np.floor(x), np.floor(y), np.floor(z)
    ax, ay, az = x - fx, y - fy, z - fz
    for c in range(channels):
        out[c] = 0.0
    for corner in range(8):
        i, j, k = int(fx) + (corner & 1), int(fy) + (corner >> 1 & 1), int(fz) + (corner >> 2)
        if wrap:
            i, j, k = i % n, j % n, k % n
        else:
            i, j, k = min(max(i, 0), n - 1), min(max(j, 0), n - 1), min(max(k, 0), n - 1)
        w = (ax if corner & 1 else 1 - ax) * (ay if corner & 2 else 1 - ay)
        w *= az if corner & 4 else 1 - az
        for c in range(channels):
            out[c] += w * volume[i, j, k, c]


@njit(cache=True, nogil=True, fastmath=True)
def albedo(
    material: NDArray[np.float32], textures: NDArray[np.uint8], volume: NDArray[np.float32],
    p: NDArray[np.float64], n: NDArray[np.float64], uv: NDArray[np.float64], pixel: float,
    out: NDArray[np.float64], noise: NDArray[np.float64],
) -> None:  # fmt: skip
    """Linear RGB reflectance at a point; pixel is a pixel's width there."""
    texture, scale, mirrored = int(material[3]), material[4], material[6] > 0
    out[:] = 0.0
    if texture < 0:
        out[:] = 1.0
    elif material[5] > 0:  # triplanar, blended by the fourth power of the normal
        total = n[0] ** 4 + n[1] ** 4 + n[2] ** 4
        for axis in range(3):
            w = n[axis] ** 4 / total
            if w > 0.01:
                u, v = p[(axis + 1) % 3], p[(axis + 2) % 3]
                if axis == 1:
                    u, v = v, u
                _texture(textures[texture], u / scale, -v / scale, pixel / scale, mirrored, w, out)
    else:
        _texture(
            textures[texture], uv[0] / scale, -uv[1] / scale, pixel / scale, mirrored, 1.0, out
        )
    if material[9] > 0:
        s = VOLUME_CELLS / (8 * material[10])
        _trilinear(volume, p[0] * s, p[1] * s, p[2] * s, True, noise)
        factor = max(1 + material[9] * noise[0], 0.1)
        for k in range(3):
            out[k] *= factor
    for k in range(3):
        out[k] *= material[k]


@njit(cache=True, nogil=True, fastmath=True)
def _roughen(
    material: NDArray[np.float32], volume: NDArray[np.float32], p: NDArray[np.float64],
    n: NDArray[np.float64], pixel: float, noise: NDArray[np.float64],
) -> None:  # fmt: skip
    """Tilt the normal by the noise's gradient, less where a pixel covers the bumps."""
    s = VOLUME_CELLS / (8 * material[12])
    strength = material[11] * min(1.0, 1.0 / (s * pixel + 1e-9))
    if strength < 0.01:
        return
    _trilinear(volume, p[0] * s, p[1] * s, p[2] * s, True, noise)
    along = noise[1] * n[0] + noise[2] * n[1] + noise[3] * n[2]
    length = 0.0
    for k in range(3):
        n[k] -= strength * (noise[1 + k] - along * n[k])
        length += n[k] * n[k]
    length = np.sqrt(length)
    for k in range(3):
        n[k] /= length


@njit(cache=True, nogil=True, fastmath=True)
def _lit(
    extrinsics: NDArray[np.float32], focal: float, softness: float, depths: NDArray[np.float32],
    p: NDArray[np.float64], n: NDArray[np.float64], lamp: bool,
) -> float:  # fmt: skip
    """Share of a light that reaches p: soft shadow, and the cone's edge for lamps."""
    z = extrinsics[2, 0] * p[0] + extrinsics[2, 1] * p[1] + extrinsics[2, 2] * p[2]
    z += extrinsics[2, 3]
    if z < 0.05:
        return 0.0
    lift = (1.0 + softness) * z / focal  # off the surface by the width that the taps cover
    x, y, z = extrinsics[0, 3], extrinsics[1, 3], extrinsics[2, 3]
    for k in range(3):
        q = p[k] + lift * n[k]
        x, y, z = x + extrinsics[0, k] * q, y + extrinsics[1, k] * q, z + extrinsics[2, k] * q
    half = SHADOW_SIDE / 2
    u, v = focal * x / z, focal * y / z
    share = 1.0
    if lamp:
        share = min(max((1 - np.sqrt(u * u + v * v) / half) * 3, 0.0), 1.0)
    if share <= 0 or abs(u) > half - 1 or abs(v) > half - 1:
        return share
    inverse, bright = 1.002 / z, 0
    for tap in range(TAPS):
        i = int(v + softness * DISC[tap, 1] + half)
        j = int(u + softness * DISC[tap, 0] + half)
        i, j = min(max(i, 0), SHADOW_SIDE - 1), min(max(j, 0), SHADOW_SIDE - 1)
        bright += 1 if depths[i, j] < inverse else 0
    return share * bright / TAPS


@njit(cache=True, nogil=True, fastmath=True)
def shade(
    material: NDArray[np.float32], p: NDArray[np.float64], n: NDArray[np.float64],
    uv: NDArray[np.float64], view: NDArray[np.float64], pixel: float,
    textures: NDArray[np.uint8], volume: NDArray[np.float32],
    lights: tuple, ambient: NDArray[np.float64], out: NDArray[np.float64],
    noise: NDArray[np.float64],
) -> None:  # fmt: skip
    """Linear RGB that a point sends to the eye.

    Args:
        material: one row of the table.
        p: (3,) world position.
        n: (3,) unit normal on the eye's side; changed by bumps.
        uv: (2,) texture coordinates.
        view: (3,) unit vector to the eye.
        pixel: width of a pixel at p, scene units.
        textures: all pyramids.
        volume: noise volume.
        lights: fields of LightMaps in order.
        ambient: (2, 3) linear RGB from above and below.
        out: (3,) result.
        noise: (4,) scratch.
    """
    extrinsics, focal, colours, kinds, maps, occupancy, grid_low, grid_cell = lights
    albedo(material, textures, volume, p, n, uv, pixel, out, noise)
    if material[13] > 0:
        return
    gx, gy, gz = n[0], n[1], n[2]
    lift = GRID_BLUR * grid_cell
    _trilinear(
        occupancy,
        (p[0] + lift * gx - grid_low[0]) / grid_cell - 0.5,
        (p[1] + lift * gy - grid_low[1]) / grid_cell - 0.5,
        (p[2] + lift * gz - grid_low[2]) / grid_cell - 0.5,
        False,
        noise,
    )
    open_share = 1.0 / (1.0 + CROWD * max(noise[0] - LONE, 0.0))
    shadow_normal = np.array([gx, gy, gz])
    if material[11] > 0:
        _roughen(material, volume, p, n, pixel, noise)
    facing = max(n[0] * view[0] + n[1] * view[1] + n[2] * view[2], 0.0)
    sheen = material[7] * (FRESNEL + (1 - FRESNEL) * (1 - facing) ** 5)
    reflected_up = 2 * facing * n[2] - view[2]
    up, mirror = 0.5 + 0.5 * n[2], min(max(0.5 + reflected_up, 0.0), 1.0)
    diffuse, gleam = np.zeros(3), np.zeros(3)
    for k in range(3):
        diffuse[k] = open_share * (up * ambient[0, k] + (1 - up) * ambient[1, k])
        gleam[k] = sheen * open_share * (mirror * ambient[0, k] + (1 - mirror) * ambient[1, k])
    for light in range(focal.shape[0]):
        e = extrinsics[light]
        direction = np.empty(3)
        distance2 = 0.0
        for k in range(3):  # from p to the light's position
            at = -(e[0, k] * e[0, 3] + e[1, k] * e[1, 3] + e[2, k] * e[2, 3])
            direction[k] = at - p[k]
            distance2 += direction[k] ** 2
        direction /= np.sqrt(distance2)
        cosine = n[0] * direction[0] + n[1] * direction[1] + n[2] * direction[2]
        if cosine <= 0:
            continue
        lamp = kinds[light, 0] > 0
        share = _lit(e, focal[light], kinds[light, 1], maps[light], p, shadow_normal, lamp)
        if share <= 0:
            continue
        if lamp:
            share /= max(distance2, 0.05)
        half = direction + view
        half /= np.sqrt((half * half).sum())
        spark = max(n[0] * half[0] + n[1] * half[1] + n[2] * half[2], 0.0) ** material[8]
        spark *= material[7] * (material[8] + 8) / 25
        for k in range(3):
            diffuse[k] += share * cosine * colours[light, k]
            gleam[k] += share * cosine * spark * colours[light, k] * 0.2
    for k in range(3):
        out[k] = out[k] * diffuse[k] + gleam[k]
