"""What stands on and around the example room's table: teapot, flowers, fruit, books, a cat."""

import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.builder import Material
from styl3r_export.scenes.meshes import Mesh, box, merged, spin, surface
from styl3r_export.scenes.solids import blob, cylinder, lathe, torus, tube
from styl3r_export.scenes.things import leafage

Vector = NDArray[np.float64]
Parts = list[tuple[Mesh, Material]]


def curve(knots: list[tuple[float, ...]], count: int = 20) -> Vector:
    """Points along a smooth (Catmull-Rom) curve through knots."""
    p = np.asarray(knots, np.float64)
    p = np.concatenate([2 * p[:1] - p[1:2], p, 2 * p[-1:] - p[-2:-1]])
    t = np.linspace(0, len(knots) - 1 - 1e-9, count)
    k, s = t.astype(int), (t % 1)[:, None]
    a, b, c, d = p[k], p[k + 1], p[k + 2], p[k + 3]
    return b + 0.5 * s * (c - a + s * (2 * a - 5 * b + 4 * c - d + s * (3 * (b - c) + d - a)))


def paint(red: float, green: float, blue: float, **looks: float) -> Material:
    """A plain glossy material from an sRGB colour."""
    tint = tuple(float(v) ** 2.2 for v in (red, green, blue))
    return Material((tint[0], tint[1], tint[2]), **looks)  # type: ignore[arg-type]


def _moved(parts: Parts, at: Vector, turn: float = 0.0) -> Parts:
    return [(mesh.placed(at, spin(turn)), look) for mesh, look in parts]


def teapot(at: Vector, turn: float) -> Parts:
    """A round teal teapot with a cream band."""
    body = curve([(0.05, 0.0), (0.088, 0.03), (0.1, 0.075), (0.075, 0.125), (0.045, 0.138)], 18)
    lid = curve([(0.047, 0.138), (0.04, 0.152), (0.012, 0.162), (0.001, 0.163)], 9)
    spout = curve([(0.08, 0, 0.05), (0.13, 0, 0.07), (0.145, 0, 0.115), (0.17, 0, 0.135)], 12)
    handle = curve([(-0.07, 0, 0.115), (-0.125, 0, 0.12), (-0.135, 0, 0.07), (-0.09, 0, 0.045)], 14)
    glaze = paint(0.10, 0.47, 0.50, gloss=0.9, sharpness=90.0)
    band = np.stack([np.full(5, 0.1015), np.linspace(0.066, 0.086, 5)], 1)
    band[[0, -1], 0] = 0.0985
    pot = merged(
        [
            lathe(body, 40),
            lathe(lid, 40),
            blob((0.013, 0.013, 0.012), None, 12).placed((0, 0, 0.172)),
            tube(spout, np.linspace(0.024, 0.012, 12), 14),
            tube(handle, 0.009, 12),
        ]
    )
    cream = paint(0.93, 0.88, 0.74, gloss=0.9, sharpness=90.0)
    return _moved([(pot, glaze), (lathe(band, 40), cream)], at, turn)


def cup(at: Vector, turn: float, look: Material) -> Parts:
    """A cup with tea on its saucer."""
    wall = [
        (0.022, 0.008),
        (0.036, 0.03),
        (0.042, 0.07),
        (0.039, 0.07),
        (0.033, 0.03),
        (0.0, 0.016),
    ]
    plate = [
        (0.0, 0.002),
        (0.04, 0.002),
        (0.075, 0.014),
        (0.073, 0.018),
        (0.035, 0.008),
        (0.0, 0.008),
    ]
    ear = curve([(0.038, 0, 0.06), (0.065, 0, 0.058), (0.062, 0, 0.03), (0.035, 0, 0.028)], 10)
    tea = cylinder(0.0375, 0.001, sides=32).placed((0, 0, 0.058))
    china = merged([lathe(np.array(wall), 36), lathe(np.array(plate), 40), tube(ear, 0.005, 10)])
    return _moved(
        [(china, look), (tea, paint(0.45, 0.2, 0.05, gloss=0.8, sharpness=120.0))], at, turn
    )


def flowers(rng: np.random.Generator, at: Vector, china: Material) -> Parts:
    """A white and blue vase of sunflowers and cornflowers."""
    profile = curve([(0.045, 0.0), (0.075, 0.06), (0.07, 0.13), (0.035, 0.2), (0.05, 0.235)], 20)
    parts: Parts = [(lathe(profile, 40), china)]
    green, dark = paint(0.28, 0.45, 0.16), paint(0.25, 0.13, 0.05, bump=0.9, bump_scale=0.01)
    petals = [paint(0.98, 0.72, 0.10), paint(0.95, 0.60, 0.08), paint(0.30, 0.38, 0.85)]
    for k in range(13):
        lean, turn = rng.uniform(0.12, 0.75), 2.4 * k
        reach = rng.uniform(0.30, 0.46)
        out = np.array([np.cos(turn) * np.sin(lean), np.sin(turn) * np.sin(lean), np.cos(lean)])
        head = out * reach + np.array([0, 0, 0.17])
        stem = curve([(0, 0, 0.1), (*(out * 0.12 + [0, 0, 0.2]),), tuple(head)], 8)
        parts.append((tube(stem, 0.004, 6), green))
        facing = out + np.array([0.25, -0.9, 0.25])  # flowers turn to the light and the viewer
        facing /= np.linalg.norm(facing)
        size = 0.075 if k % 3 else 0.045
        bloom, heart = _bloom(rng, size)
        side = np.cross([0, 0, 1.0], facing)
        side /= np.linalg.norm(side)
        frame = np.stack([side, np.cross(facing, side), facing], 1)
        parts.append((bloom.placed(head, frame), petals[2 if k % 3 == 0 else k % 2]))
        parts.append((heart.placed(head + 0.006 * facing, frame), dark if k % 3 else petals[1]))
    leaves = leafage(rng, 0.26, 12).placed((0, 0, 0.2))
    parts.append((leaves, green))
    return _moved(parts, at)


def _bloom(rng: np.random.Generator, size: float) -> tuple[Mesh, Mesh]:
    """Petals in two rings facing +z, and the disc in their middle."""
    petals = []
    t = np.linspace(0, 1, 6)
    for ring in range(2):
        for k in range(13):
            length = size * rng.uniform(0.85, 1.05) * (1.0 - 0.18 * ring)
            out = 0.3 * size + t * length * 0.75
            half = 0.17 * size * np.sin(np.pi * (0.12 + 0.88 * t)) ** 0.8
            cup_ = size * (0.10 * ring + 0.25 * t**2 * rng.uniform(0.2, 1.0))
            middle = np.stack([out, 0 * t, cup_], 1)
            side = np.stack([0 * t, half, 0 * t], 1)
            rib = middle - np.array([0, 0, 0.04 * size])
            sheet = np.stack([middle - side, rib, middle + side], 1)
            petals.append(surface(sheet).placed((0, 0, 0), spin((k + ring / 2) * 2 * np.pi / 13)))
    return merged(petals), blob((0.36 * size, 0.36 * size, 0.16 * size), None, 14)


def fruit_bowl(rng: np.random.Generator, at: Vector) -> Parts:
    """A footed wooden bowl with oranges, apples and a lemon."""
    outside = curve([(0.05, 0.0), (0.045, 0.02), (0.11, 0.05), (0.15, 0.085)], 14)
    inside = curve([(0.143, 0.085), (0.10, 0.055), (0.0, 0.035)], 10)
    bowl = lathe(np.concatenate([outside, inside]), 48)
    parts: Parts = [(bowl, paint(0.50, 0.29, 0.15, gloss=0.4, stain=0.25, stain_scale=0.06))]
    looks = [
        paint(0.96, 0.55, 0.08, gloss=0.25, bump=0.25, bump_scale=0.006),
        paint(0.78, 0.12, 0.10, gloss=0.6, sharpness=60.0, stain=0.2, stain_scale=0.05),
        paint(0.93, 0.83, 0.22, gloss=0.3, bump=0.2, bump_scale=0.006),
        paint(0.55, 0.68, 0.18, gloss=0.5, sharpness=50.0),
    ]
    spots = [
        (0.0, 0.0, 0.08),
        *((0.078 * np.cos(a), 0.078 * np.sin(a), 0.085) for a in np.arange(6) * 1.05),
    ]
    spots += [(0.03, -0.02, 0.135), (-0.045, 0.02, 0.13)]
    for k, spot in enumerate(spots):
        r = 0.04 * rng.uniform(0.92, 1.08)
        radii = (r, r, r * (1.25 if k % 4 == 2 else 0.94))
        turn = spin(rng.uniform(0, 6)) @ spin(rng.uniform(-0.6, 0.6), 0)
        parts.append((blob(radii, None, 22).placed(spot, turn), looks[k % 4]))
        if k % 4 in (1, 3):
            stalk = np.array([[0, 0, 0.03], [0.004, 0, 0.05]])
            parts.append((tube(stalk, 0.0018, 5).placed(spot, turn), paint(0.25, 0.15, 0.08)))
    return _moved(parts, at)


def books(at: Vector, turn: float) -> Parts:
    """A small stack of books."""
    parts: Parts = []
    z = 0.0
    covers = [(0.62, 0.14, 0.13), (0.16, 0.25, 0.42), (0.87, 0.72, 0.38), (0.20, 0.38, 0.28)]
    for k, (w, d, h) in enumerate(
        [(0.26, 0.19, 0.035), (0.24, 0.17, 0.028), (0.22, 0.16, 0.04), (0.19, 0.13, 0.025)]
    ):
        cover, twist = paint(*covers[k], gloss=0.15), spin([0.0, 0.12, -0.1, 0.25][k])
        boards = [box((w, d, 0.004), (0, 0, z + s)) for s in (0.002, h - 0.002)]
        boards.append(box((0.006, d, h), (-w / 2 + 0.003, 0, z + h / 2)))
        pages = box((w - 0.012, d - 0.012, h - 0.008), (0.001, 0, z + h / 2))
        parts.append((merged(boards).placed((0, 0, 0), twist), cover))
        paper = paint(0.93, 0.89, 0.78, stain=0.2, stain_scale=0.01)
        parts.append((pages.placed((0, 0, 0), twist), paper))
        z += h
    return _moved(parts, at, turn)


def lamp(at: Vector) -> Parts:
    """A table lamp with a glowing shade."""
    foot = curve(
        [(0.07, 0.0), (0.065, 0.015), (0.02, 0.03), (0.045, 0.09), (0.04, 0.14), (0.012, 0.2)], 22
    )
    base = merged([lathe(foot, 32), cylinder(0.008, 0.16, sides=10).placed((0, 0, 0.19))])
    shade = lathe(np.array([[0.14, 0.25], [0.085, 0.43]]), 40)
    rims = merged(
        [torus(0.14, 0.003, 40).placed((0, 0, 0.25)), torus(0.085, 0.003, 40).placed((0, 0, 0.43))]
    )
    glow = Material((1.5, 1.02, 0.5), glow=True, stain=0.06, stain_scale=0.1)
    brick = paint(0.72, 0.33, 0.2, gloss=0.7, sharpness=60.0)
    return _moved([(base, brick), (shade, glow), (rims, paint(0.5, 0.3, 0.1))], at)


def cat(at: Vector, turn: float) -> Parts:
    """A sitting ginger cat that looks along +x."""
    fur = paint(0.83, 0.50, 0.20, bump=0.35, bump_scale=0.03, stain=0.28, stain_scale=0.05)
    white, ink = paint(0.95, 0.92, 0.86), paint(0.08, 0.06, 0.05, gloss=0.9, sharpness=100.0)
    body = [
        blob((0.12, 0.105, 0.13), None, 20).placed((-0.04, 0, 0.12)),
        blob((0.085, 0.08, 0.14), None, 20).placed((0.03, 0, 0.2), spin(0.2, 1)),
        blob((0.07, 0.068, 0.062), None, 20).placed((0.075, 0, 0.36)),
        *(blob((0.08, 0.045, 0.06), None, 14).placed((0.01, s * 0.085, 0.06)) for s in (-1, 1)),
    ]
    for s in (-1, 1):
        ear = cylinder(0.028, 0.06, 0.002, 12).placed((0.07, s * 0.04, 0.4), spin(-0.35 * s, 0))
        leg = tube(
            curve([(0.08, s * 0.035, 0.2), (0.1, s * 0.036, 0.1), (0.105, s * 0.036, 0.0)], 8),
            0.026,
            12,
        )
        body += [ear, leg]
    tail = curve(
        [(-0.14, 0.0, 0.04), (-0.2, -0.08, 0.03), (-0.1, -0.17, 0.03), (0.04, -0.16, 0.03)], 18
    )
    body.append(tube(tail, np.linspace(0.028, 0.02, 18), 12))
    chest = [
        blob((0.05, 0.05, 0.09), None, 16).placed((0.085, 0, 0.22)),
        blob((0.032, 0.036, 0.026), None, 14).placed((0.125, 0, 0.343)),
        *(blob((0.04, 0.028, 0.02), None, 12).placed((0.125, s * 0.037, 0.018)) for s in (-1, 1)),
    ]
    face = [
        blob((0.007, 0.011, 0.013), None, 12).placed((0.138, s * 0.027, 0.372)) for s in (-1, 1)
    ]
    face.append(blob((0.007, 0.009, 0.006), None, 10).placed((0.157, 0, 0.352)))
    return _moved([(merged(body), fur), (merged(chest), white), (merged(face), ink)], at, turn)


def pot_plant(rng: np.random.Generator, at: Vector, height: float) -> Parts:
    """A fern in a terracotta pot."""
    wall = [
        (0.0, 0.0),
        (0.09, 0.0),
        (0.125, 0.2),
        (0.14, 0.2),
        (0.14, 0.235),
        (0.12, 0.235),
        (0.11, 0.19),
        (0.0, 0.19),
    ]
    clay = paint(0.72, 0.40, 0.26, stain=0.2, stain_scale=0.15)
    green = paint(0.25, 0.46, 0.18, gloss=0.25, stain=0.35, stain_scale=0.2)
    crown = leafage(rng, height, 46).placed((0, 0, 0.19))
    return _moved([(lathe(np.array(wall), 36), clay), (crown, green)], at)
