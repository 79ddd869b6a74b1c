"""What stands outdoors: sky and sun, ground, house fronts, trees, railings, far backdrops."""

import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.builder import Light, Material, SceneBuilder
from styl3r_export.scenes.indoors import warm_white
from styl3r_export.scenes.meshes import Mesh, box, merged, random_turn, spin, surface
from styl3r_export.scenes.noise import spectral
from styl3r_export.scenes.patterns import SIDE
from styl3r_export.scenes.solids import cylinder, tube
from styl3r_export.scenes.things import foliage, leafage, lump

Vector = NDArray[np.float64]
#: Radius of the sky dome; far enough that a walk causes no parallax in it.
SKY_RADIUS = 400.0


def sky(builder: SceneBuilder) -> None:
    """A dome with its picture, the sun, and the ambient light of both."""
    rng = builder.rng
    picture, tone = _sky_picture(rng)
    builder.pictures.append((np.clip(picture, 0, 1) * 255).astype(np.uint8))
    turn = rng.uniform(0, 2 * np.pi)
    azimuth, climb = np.meshgrid(np.linspace(0, 2 * np.pi, 33), np.linspace(-0.5, 0.5, 17) * np.pi)
    unit = [np.cos(climb) * np.cos(azimuth), np.cos(climb) * np.sin(azimuth), np.sin(climb)]
    uv = np.stack([azimuth / np.pi, np.clip(climb / np.pi * 2, 0.0, 1.0)], -1)
    dome = surface(SKY_RADIUS * np.stack(unit, -1), uv).placed((0, 0, 0), spin(turn))
    bright = tuple(np.full(3, rng.uniform(0.9, 2.0)).tolist())
    texture = len(builder.pictures) - 1
    look = Material(bright, texture, 1.0, mirrored=True, glow=True, sky=True, casts=False)
    builder.add(dome, look)
    overcast = rng.random() < 0.35
    ground = np.array([0.38, 0.33, 0.27])
    builder.ambient = np.stack([0.8 * tone, 0.5 * ground]) * rng.uniform(0.5, 0.9)
    turn, height = rng.uniform(0, 2 * np.pi), rng.uniform(0.25, 1.3)
    flat = np.cos(height)
    away = np.array([np.cos(turn) * flat, np.sin(turn) * flat, np.sin(height)])
    strength = rng.uniform(0.1, 0.4) if overcast else rng.uniform(0.8, 2.2)
    softness = rng.uniform(4, 10) if overcast else rng.uniform(0.6, 2.5)
    spread = 2 * np.arctan(14 / 120)
    middle = np.array([0.0, 0.0, 2.0])
    builder.lights.append(
        Light(middle + 120 * away, middle, spread, warm_white(rng) * strength, False, softness)
    )


def _sky_picture(rng: np.random.Generator) -> tuple[NDArray[np.float64], Vector]:
    """(256, 256, 3) sRGB from zenith (top) to horizon, mirrored sideways, and its linear tone."""
    zenith = np.array([0.25, 0.45, 0.85]) * rng.uniform(0.7, 1.1)
    horizon = np.array([0.75, 0.85, 0.95]) * rng.uniform(0.85, 1.05)
    if rng.random() < 0.25:  # evening
        horizon = np.array([0.98, 0.72, 0.5])
    cover = float(rng.choice([0.0, rng.uniform(0, 1), 1.0]))
    height = np.linspace(1, 0, SIDE)[:, None, None] ** rng.uniform(0.4, 0.9)
    clear = horizon + (zenith - horizon) * height
    field = spectral(rng, (SIDE, SIDE), rng.uniform(1.3, 1.9), 2.0)
    share = np.clip((field + 3 * cover - 1.2) * rng.uniform(0.5, 2), 0, 1)[..., None] * cover
    cloud = np.clip(0.86 + 0.08 * spectral(rng, (SIDE, SIDE), 1.8, 2.0), 0.55, 1)[..., None]
    picture = clear + (cloud * rng.uniform(0.75, 1.0) - clear) * share
    return picture, picture.mean((0, 1)) ** 2.2


def terrain(rng: np.random.Generator, reach: float, height: float, cells: int = 48) -> Mesh:
    """Rolling or rough ground: a heightfield, finer in the middle."""
    t = np.linspace(-1, 1, cells + 1)
    axis = reach * np.sign(t) * (0.25 * np.abs(t) + 0.75 * np.abs(t) ** 3)
    x, y = np.meshgrid(axis, axis)
    field = spectral(rng, (128, 128), rng.uniform(1.6, 2.4), rng.uniform(1, 4))
    rows = ((y / reach + 1) * 63).astype(int)
    columns = ((x / reach + 1) * 63).astype(int)
    z = height * field[rows, columns]
    return surface(np.stack([x, y, z], -1), np.stack([x, y], -1))


def facade(
    builder: SceneBuilder, wide: float, tall: float, deep: float
) -> list[tuple[Mesh, Material]]:
    """A building's front towards -y: body, rows of windows with frames, cornices, a door."""
    rng = builder.rng
    body = builder.material(3.0, plain=0.25, gloss=0.0)
    trim = builder.material(0.5, plain=0.8)
    glass = builder.material(0.8, plain=0.8, tint=tuple(rng.uniform(0.01, 0.15, 3)), gloss=0.8)
    parts: list[tuple[Mesh, Material]] = [(box((wide, deep, tall), (0, deep / 2, tall / 2)), body)]
    floors = max(1, int(tall / rng.uniform(2.6, 3.8)))
    count = max(1, int(wide / rng.uniform(1.6, 3.2)))
    w, h = wide / count * rng.uniform(0.35, 0.65), tall / floors * rng.uniform(0.45, 0.7)
    frames, panes, arch = [], [], rng.random() < 0.3
    sill, depth = rng.uniform(0.0, 0.25), rng.uniform(0.04, 0.22)
    bars = int(rng.integers(0, 3))
    for f in range(floors):
        for k in range(count):
            x, z = ((k + 0.5) / count - 0.5) * wide, (f + 0.52) * tall / floors
            panes.append(box((w, 0.04, h), (x, -0.02, z)))
            frames += [box((0.12, depth, h + 0.2), (x + s * w / 2, -depth / 2, z)) for s in (-1, 1)]
            frames.append(box((w + 0.3, depth + 0.1, 0.14), (x, -depth / 2, z + h / 2)))
            if sill > 0.05:
                frames.append(
                    box((w + 0.3, depth + sill, 0.1), (x, -(depth + sill) / 2, z - h / 2))
                )
            frames += [
                box((0.05, 0.07, h), (x + (b + 1) / (bars + 1) * w - w / 2, -0.03, z))
                for b in range(bars)
            ]
            if arch:
                ring = np.linspace(0, np.pi, 9)
                curve = np.stack(
                    [
                        x + w * 0.55 * np.cos(ring),
                        0 * ring - 0.05,
                        z + h / 2 + w * 0.4 * np.sin(ring),
                    ],
                    1,
                )
                frames.append(tube(curve, 0.09, 6))
    for z in (tall, tall / floors, 0.15):
        if rng.random() < 0.7:
            out = rng.uniform(0.1, 0.5)
            frames.append(box((wide + 0.1, out, rng.uniform(0.1, 0.5)), (0, -out / 2 + 0.02, z)))
    if rng.random() < 0.4:
        frames += [
            cylinder(0.18, tall * 0.9, 0.15, 12).placed((x, -0.25, 0))
            for x in np.linspace(-wide / 2, wide / 2, count + 1)
        ]
    parts += [(merged(panes), glass), (merged(frames), trim)]
    if rng.random() < 0.6:
        door = box((1.3, 0.1, 2.3), (rng.uniform(-0.3, 0.3) * wide, -0.05, 1.15))
        parts.append((door, builder.material(1.2, plain=0.4)))
    if rng.random() < 0.5:
        ridge = np.array([[-1, -0.6], [0, 2.2], [1, -0.6]]) * deep / 2
        ends = np.array([-wide / 2 - 0.3, wide / 2 + 0.3])
        sheet = np.stack([
            np.stack([np.full(3, e), ridge[:, 0] + deep / 2, ridge[:, 1] + tall + 0.3 * deep], 1)
            for e in ends
        ])  # fmt: skip
        for k in range(2):
            parts.append((surface(sheet[:, k : k + 2]), builder.material(2.0, plain=0.2)))
    return parts


def tree(builder: SceneBuilder, at: Vector) -> None:
    """A trunk with branches and a crown of lumps or leaf tufts."""
    rng = builder.rng
    tall = rng.uniform(2.5, 8)
    bark = builder.material(0.6, plain=0.1, triplanar=True, bump=0.5, bump_scale=0.1)
    lean = np.array([*rng.normal(0, 0.08, 2), 1.0])
    t = np.linspace(0, 1, 6)
    trunk = [tube(t[:, None] * lean * tall * 0.7, tall * 0.035 * (1.3 - t), 9)]
    crown, kind = [], rng.random()
    for _ in range(int(rng.integers(5, 12))):
        share = rng.uniform(0.4, 0.75)
        root, out = lean * tall * share, rng.normal(0, 1, 3) * [1, 1, 0.4] + [0, 0, 0.6]
        tip = root + out / np.linalg.norm(out) * tall * rng.uniform(0.15, 0.3)
        trunk.append(tube(np.linspace(root, tip, 4), tall * 0.012, 5))
        if kind < 0.3:
            crown.append(leafage(rng, tall * 0.2, 14).placed(tip, random_turn(rng)))
        elif kind < 0.75:
            size = tall * rng.uniform(0.08, 0.2, 3)
            crown.append(foliage(rng, size, 120, tall * rng.uniform(0.02, 0.045)).placed(tip))
        else:
            size = tall * rng.uniform(0.08, 0.2, 3)
            crown.append(lump(rng, size, 0.8, 10).placed(tip, random_turn(rng)))
    builder.add(merged(trunk).placed(at), bark)
    green = tuple(np.array([0.12, 0.22, 0.05]) * np.exp(rng.normal(0, 0.5, 3)))
    look = builder.material(
        0.8, plain=0.0, triplanar=True, tint=tuple(2.5 * np.array(green)), stain=0.5,
        stain_scale=0.3, bump=0.9, bump_scale=0.12,
    )  # fmt: skip
    builder.add(merged(crown).placed(at), look)


def rail(builder: SceneBuilder, at: Vector, turn: float, wide: float) -> None:
    """A fence, railing or row of posts: thin repeated structure."""
    rng = builder.rng
    tall, gap = rng.uniform(0.5, 1.6), rng.uniform(0.08, 0.5)
    thick = gap * rng.uniform(0.08, 0.5)
    posts = [
        box((thick, thick, tall), (x, 0, tall / 2)) for x in np.arange(-wide / 2, wide / 2, gap)
    ]
    bars = [box((wide, thick, thick), (0, 0, z)) for z in (0.15 * tall, 0.9 * tall)]
    builder.add(merged(posts + bars).placed(at, spin(turn)), builder.material(0.5, plain=0.5))


def backdrop(builder: SceneBuilder) -> None:
    """Far houses, hills and tree lines all around."""
    rng = builder.rng
    for _ in range(int(rng.integers(4, 16))):
        turn, far = rng.uniform(0, 2 * np.pi), rng.uniform(25, 80)
        at = far * np.array([np.cos(turn), np.sin(turn), 0])
        kind = rng.random()
        if kind < 0.4:
            size = np.array([rng.uniform(6, 25), 8, rng.uniform(4, 20)])
            look = builder.material(6.0, plain=0.1)
            builder.add(box(size, (0, 0, size[2] / 2)).placed(at, spin(turn + np.pi / 2)), look)
        elif kind < 0.7:
            size = np.array([rng.uniform(8, 30), rng.uniform(8, 20), rng.uniform(3, 12)])
            look = builder.material(8.0, plain=0.1, triplanar=True)
            builder.add(lump(rng, size, 0.5, 12).placed(at), look)
        else:
            tree(builder, at * 0.5)
