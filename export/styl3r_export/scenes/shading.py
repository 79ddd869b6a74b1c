"""Light that a surface point sends to the eye: soft shadows, highlights, contact darkening."""

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.splatting.compiler import kernel
from styl3r_export.scenes.lighting import GRID, GRID_BLUR, SHADOW_SIDE
from styl3r_export.scenes.surface_colour import Vector, albedo, roughened

#: Occupancy read GRID_BLUR cells above a lone flat surface: no occlusion up to here.
LONE = 0.20
#: How fast surplus occupancy darkens ambient light (1: a crowded cell halves it).
CROWD = 2.2
#: Reflection of a smooth dielectric looked at straight on.
FRESNEL = 0.04
#: Offsets of the shadow taps: a sunflower disc of 12; where its rim agrees, that is enough.
TAPS, RIM = 12, 5
_turns = np.arange(TAPS) * 2.399963
_reach = np.sqrt((np.arange(TAPS) + 0.5) / TAPS)[::-1]
DISC = np.stack([_reach * np.cos(_turns), _reach * np.sin(_turns)], 1).astype(np.float32)
#: Depth margin against a surface shadowing itself, relative.
SHADOW_BIAS = 1.002
#: Lamps are no nearer than this (squared), so that nothing under them burns out.
LAMP_NEAREST2 = 0.05


@kernel
def _openness(
    occupancy: NDArray[np.float32], low: NDArray[np.float32], cell: float, p: Vector, n: Vector
) -> float:
    """Share of ambient light that reaches p, from how crowded the space before it is."""
    lift = GRID_BLUR * cell
    x = (p[0] + lift * n[0] - low[0]) / cell - 0.5
    y = (p[1] + lift * n[1] - low[1]) / cell - 0.5
    z = (p[2] + lift * n[2] - low[2]) / cell - 0.5
    top = GRID - 2.0
    if x < 0 or y < 0 or z < 0 or x > top or y > top or z > top:
        return 1.0
    i, j, k = int(x), int(y), int(z)
    ax, ay, az = x - i, y - j, z - k
    crowd = 0.0
    for corner in range(8):
        dx, dy, dz = corner & 1, corner >> 1 & 1, corner >> 2
        w = (ax if dx else 1 - ax) * (ay if dy else 1 - ay) * (az if dz else 1 - az)
        crowd += w * occupancy[i + dx, j + dy, k + dz]
    return 1.0 / (1.0 + CROWD * max(crowd - LONE, 0.0))


@kernel
def _lit(
    e: NDArray[np.float32], focal: float, softness: float, depths: NDArray[np.float32],
    p: Vector, n: Vector, lamp: bool,
) -> float:  # fmt: skip
    """Share of a light that reaches p: soft shadow, and the cone's edge for lamps."""
    z = e[2, 0] * p[0] + e[2, 1] * p[1] + e[2, 2] * p[2] + e[2, 3]
    if z < 0.05:
        return 0.0
    lift = (1.0 + softness) * z / focal  # off the surface by the width that the taps cover
    px, py, pz = p[0] + lift * n[0], p[1] + lift * n[1], p[2] + lift * n[2]
    x = e[0, 0] * px + e[0, 1] * py + e[0, 2] * pz + e[0, 3]
    y = e[1, 0] * px + e[1, 1] * py + e[1, 2] * pz + e[1, 3]
    z = e[2, 0] * px + e[2, 1] * py + e[2, 2] * pz + e[2, 3]
    half = SHADOW_SIDE / 2
    u, v = focal * x / z, focal * y / z
    share = 1.0
    if lamp:
        share = min(max((1 - np.sqrt(u * u + v * v) / half) * 3, 0.0), 1.0)
    if share <= 0 or abs(u) > half - 1 or abs(v) > half - 1:
        return share
    inverse, bright = SHADOW_BIAS / z, 0
    for tap in range(TAPS):
        i = int(v + softness * DISC[tap, 1] + half)
        j = int(u + softness * DISC[tap, 0] + half)
        i, j = min(max(i, 0), SHADOW_SIDE - 1), min(max(j, 0), SHADOW_SIDE - 1)
        bright += 1 if depths[i, j] < inverse else 0
        if tap == RIM - 1 and (bright == 0 or bright == RIM):
            return share * bright / RIM
    return share * bright / TAPS


@kernel
def shade(
    material: NDArray[np.float32], p: Vector, n: Vector, uv: tuple[float, float], view: Vector,
    pixel: float, textures: NDArray[np.uint8], volume: NDArray[np.float32], lights: tuple,
    ambient: NDArray[np.float64],
) -> Vector:  # fmt: skip
    """Linear RGB that a point sends to the eye.

    Args:
        material: one row of the table.
        p: world position.
        n: unit normal on the eye's side.
        uv: texture coordinates.
        view: unit vector to the eye.
        pixel: width of a pixel at p, scene units.
        textures: all pyramids.
        volume: noise volume.
        lights: fields of LightMaps in order.
        ambient: (2, 3) linear RGB from above and below.
    """
    places, extrinsics, focal, colours, kinds, maps, occupancy, grid_low, grid_cell = lights
    red, green, blue = albedo(material, textures, volume, p, n, uv, pixel)
    if material[13] > 0:
        return red, green, blue
    smooth = n
    if material[11] > 0:
        n = roughened(material, volume, p, n, pixel)
    free = _openness(occupancy, grid_low, grid_cell, p, smooth)
    gloss, sharpness = float(material[7]), float(material[8])
    facing = max(n[0] * view[0] + n[1] * view[1] + n[2] * view[2], 0.0)
    sheen = free * gloss * (FRESNEL + (1 - FRESNEL) * (1 - facing) ** 5)
    up, mirror = 0.5 + 0.5 * n[2], min(max(0.5 + 2 * facing * n[2] - view[2], 0.0), 1.0)
    up *= free
    down, under = free - up, 1 - mirror
    dr = up * ambient[0, 0] + down * ambient[1, 0]
    dg = up * ambient[0, 1] + down * ambient[1, 1]
    db = up * ambient[0, 2] + down * ambient[1, 2]
    gr = sheen * (mirror * ambient[0, 0] + under * ambient[1, 0])
    gg = sheen * (mirror * ambient[0, 1] + under * ambient[1, 1])
    gb = sheen * (mirror * ambient[0, 2] + under * ambient[1, 2])
    for light in range(focal.shape[0]):
        x = places[light, 0] - p[0]
        y = places[light, 1] - p[1]
        z = places[light, 2] - p[2]
        distance2 = x * x + y * y + z * z
        distance = np.sqrt(distance2)
        x, y, z = x / distance, y / distance, z / distance
        cosine = n[0] * x + n[1] * y + n[2] * z
        if cosine <= 0:
            continue
        lamp = kinds[light, 0] > 0
        e, softness = extrinsics[light], float(kinds[light, 1])
        share = _lit(e, focal[light], softness, maps[light], p, smooth, lamp)
        if share <= 0:
            continue
        if lamp:
            share /= max(distance2, LAMP_NEAREST2)
        spark = 0.0
        if gloss > 0:
            hx, hy, hz = x + view[0], y + view[1], z + view[2]
            half = (n[0] * hx + n[1] * hy + n[2] * hz) / np.sqrt(hx * hx + hy * hy + hz * hz)
            spark = gloss * (sharpness + 8) / 125 * max(half, 0.0) ** sharpness
        direct, gleam = share * cosine, share * cosine * spark
        dr, gr = dr + direct * colours[light, 0], gr + gleam * colours[light, 0]
        dg, gg = dg + direct * colours[light, 1], gg + gleam * colours[light, 1]
        db, gb = db + direct * colours[light, 2], gb + gleam * colours[light, 2]
    return red * dr + gr, green * dg + gg, blue * db + gb
