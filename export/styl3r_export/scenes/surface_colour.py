"""Reflectance of a surface point: trilinear textures, planar or triplanar, and noise."""

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.splatting.compiler import kernel
from styl3r_export.scenes.builder import Material
from styl3r_export.scenes.noise import VOLUME_CELLS
from styl3r_export.scenes.patterns import SIDE
from styl3r_export.scenes.textures import LEVELS

#: Three or four numbers: tuples stay in registers, small arrays would be allocated per pixel.
Vector = tuple[float, float, float]

_codes = np.arange(256) / 255
#: Linear value of each 8-bit sRGB code.
LINEAR = np.where(_codes <= 0.04045, _codes / 12.92, ((_codes + 0.055) / 1.055) ** 2.4).astype(
    np.float32
)
#: A texture's share below which a projection or level is not worth reading.
NEGLIGIBLE = 0.02
#: The noise volume holds about this many waves per side.
VOLUME_WAVES = 8


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


@kernel
def _wrapped(i: int, side: int, mirrored: bool) -> int:
    """Texel index of a coordinate outside the picture; side is a power of two."""
    if mirrored:
        i &= 2 * side - 1
        return 2 * side - 1 - i if i >= side else i
    return i & (side - 1)


@kernel
def _bilinear(
    pyramid: NDArray[np.uint8], start: int, side: int, u: float, v: float, mirrored: bool
) -> Vector:
    """Sample of one level at (u, v) in texture lengths."""
    x, y = u * side - 0.5, v * side - 0.5
    fx, fy = np.floor(x), np.floor(y)
    ax, ay = x - fx, y - fy
    left, top = int(fx), int(fy)
    j0, j1 = _wrapped(left, side, mirrored), _wrapped(left + 1, side, mirrored)
    i0 = start + _wrapped(top, side, mirrored) * side
    i1 = start + _wrapped(top + 1, side, mirrored) * side
    a, b, c, d = i0 + j0, i0 + j1, i1 + j0, i1 + j1
    wa, wb, wc, wd = (1 - ax) * (1 - ay), ax * (1 - ay), (1 - ax) * ay, ax * ay
    return (
        wa * LINEAR[pyramid[a, 0]] + wb * LINEAR[pyramid[b, 0]]
        + wc * LINEAR[pyramid[c, 0]] + wd * LINEAR[pyramid[d, 0]],
        wa * LINEAR[pyramid[a, 1]] + wb * LINEAR[pyramid[b, 1]]
        + wc * LINEAR[pyramid[c, 1]] + wd * LINEAR[pyramid[d, 1]],
        wa * LINEAR[pyramid[a, 2]] + wb * LINEAR[pyramid[b, 2]]
        + wc * LINEAR[pyramid[c, 2]] + wd * LINEAR[pyramid[d, 2]],
    )  # fmt: skip


@kernel
def _texture(
    pyramid: NDArray[np.uint8], u: float, v: float, footprint: float, mirrored: bool
) -> Vector:
    """Trilinear sample; footprint is a pixel's width in texture lengths."""
    level = min(max(np.log2(max(footprint * SIDE, 1e-6)), 0.0), LEVELS - 1.0)
    low = int(level)
    part = level - low
    start, side = 0, SIDE
    for _ in range(low):
        start += side * side
        side //= 2
    r, g, b = _bilinear(pyramid, start, side, u, v, mirrored)
    if part > NEGLIGIBLE and side > 1:
        s, h, c = _bilinear(pyramid, start + side * side, side // 2, u, v, mirrored)
        r, g, b = r + part * (s - r), g + part * (h - g), b + part * (c - b)
    return r, g, b


@kernel
def volume_noise(volume: NDArray[np.float32], p: Vector, wavelength: float) -> tuple:
    """Tiled noise and its gradient at a point: (value, d/dx, d/dy, d/dz)."""
    s = VOLUME_CELLS / (VOLUME_WAVES * wavelength)
    x, y, z = p[0] * s, p[1] * s, p[2] * s
    fx, fy, fz = np.floor(x), np.floor(y), np.floor(z)
    ax, ay, az = x - fx, y - fy, z - fz
    mask = VOLUME_CELLS - 1
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for corner in range(8):
        i = (int(fx) + (corner & 1)) & mask
        j = (int(fy) + (corner >> 1 & 1)) & mask
        k = (int(fz) + (corner >> 2)) & mask
        w = (ax if corner & 1 else 1 - ax) * (ay if corner & 2 else 1 - ay)
        w *= az if corner & 4 else 1 - az
        a, b = a + w * volume[i, j, k, 0], b + w * volume[i, j, k, 1]
        c, d = c + w * volume[i, j, k, 2], d + w * volume[i, j, k, 3]
    return a, b, c, d


@kernel
def albedo(
    material: NDArray[np.float32], textures: NDArray[np.uint8], volume: NDArray[np.float32],
    p: Vector, n: Vector, uv: tuple[float, float], pixel: float,
) -> Vector:  # fmt: skip
    """Linear RGB reflectance at a point; pixel is a pixel's width there."""
    texture, scale, mirrored = int(material[3]), float(material[4]), material[6] > 0
    r, g, b = 1.0, 1.0, 1.0
    if texture >= 0 and material[5] > 0:  # triplanar, blended by the fourth power of the normal
        wx, wy, wz = n[0] ** 4, n[1] ** 4, n[2] ** 4
        total = wx + wy + wz
        r, g, b = 0.0, 0.0, 0.0
        for axis in range(3):
            w = (wx if axis == 0 else wy if axis == 1 else wz) / total
            if w > NEGLIGIBLE:
                u = p[1] if axis == 0 else p[0]
                v = p[1] if axis == 2 else p[2]
                sample = _texture(textures[texture], u / scale, -v / scale, pixel / scale, mirrored)
                r, g, b = r + w * sample[0], g + w * sample[1], b + w * sample[2]
    elif texture >= 0:
        r, g, b = _texture(
            textures[texture], uv[0] / scale, -uv[1] / scale, pixel / scale, mirrored
        )
    if material[9] > 0:
        stain = volume_noise(volume, p, material[10])[0]
        factor = max(1 + material[9] * stain, 0.1)
        r, g, b = r * factor, g * factor, b * factor
    return r * material[0], g * material[1], b * material[2]


@kernel
def roughened(
    material: NDArray[np.float32], volume: NDArray[np.float32], p: Vector, n: Vector, pixel: float
) -> Vector:
    """The normal tilted by the noise's gradient, less where a pixel covers the bumps."""
    s = VOLUME_CELLS / (VOLUME_WAVES * material[12])
    strength = material[11] * min(1.0, 1.0 / (s * pixel + 1e-9))
    if strength < NEGLIGIBLE:
        return n
    _, gx, gy, gz = volume_noise(volume, p, material[12])
    along = gx * n[0] + gy * n[1] + gz * n[2]
    x = n[0] - strength * (gx - along * n[0])
    y = n[1] - strength * (gy - along * n[1])
    z = n[2] - strength * (gz - along * n[2])
    length = np.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length
