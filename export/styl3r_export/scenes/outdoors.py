"""Streets, squares, gardens, statues and walls seen close, under a sky."""

import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.builder import Light, SceneBuilder, Stage
from styl3r_export.scenes.indoors import warm_white
from styl3r_export.scenes.meshes import (
    Mesh,
    blob,
    box,
    cylinder,
    lathe,
    merged,
    quad,
    random_turn,
    spin,
    surface,
    tube,
)
from styl3r_export.scenes.noise import spectral
from styl3r_export.scenes.things import add_thing, figure, leafage, lump

Vector = NDArray[np.float64]
#: Radius of the sky dome; far enough that a walk causes no parallax in it.
SKY_RADIUS = 400.0


def sky(builder: SceneBuilder) -> None:
    """A dome with clouds or a plain gradient, the sun, and its ambient light."""
    rng = builder.rng
    tilt = rng.uniform(0, 2 * np.pi)
    dome = blob((SKY_RADIUS,) * 3, None, 16).placed((0, 0, 0), spin(tilt))
    blue = np.array([0.35, 0.55, 0.95]) * rng.uniform(0.7, 1.3)
    grey = np.full(3, rng.uniform(0.5, 1.1))
    tone = blue + rng.uniform(0, 1) * (grey - blue)
    bands = []
    for k in range(8):  # rings paler towards the horizon
        low, high = -0.2 + 1.1 * k / 8, -0.2 + 1.1 * (k + 1) / 8
        heights = dome.vertices[:, :, 2].mean(1) / SKY_RADIUS
        chosen = (heights >= (low if k else -2)) & (heights < (high if k < 7 else 2))
        bands.append((chosen, tone + (grey * 1.1 - tone) * np.clip(1 - k / 5, 0, 1)))
    clouded = rng.random() < 0.4
    cloud = builder.picture() if clouded else -1
    for chosen, hue in bands:
        part = Mesh(dome.vertices[chosen], dome.normals[chosen], dome.uvs[chosen])
        tint = tuple(float(v) for v in hue * (1.6 if clouded else 1.0))
        look = builder.material(
            300.0, plain=1.0, tint=tint, texture=cloud, scale=300.0, glow=True, sky=True,
            casts=False, stain=rng.uniform(0, 0.15), stain_scale=200.0,
        )  # fmt: skip
        builder.add(part, look)
    overcast = rng.random() < 0.35
    builder.ambient = np.stack([0.5 * tone + 0.3 * grey, 0.5 * np.array([0.35, 0.3, 0.25])])
    builder.ambient = builder.ambient * rng.uniform(0.5, 0.9)
    turn, climb = rng.uniform(0, 2 * np.pi), rng.uniform(0.25, 1.3)
    away = np.array([np.cos(turn) * np.cos(climb), np.sin(turn) * np.cos(climb), np.sin(climb)])
    strength = rng.uniform(0.1, 0.4) if overcast else rng.uniform(0.8, 2.2)
    softness = rng.uniform(4, 10) if overcast else rng.uniform(0.6, 2.5)
    spread = 2 * np.arctan(14 / 120)
    middle = np.array([0.0, 0.0, 2.0])
    builder.lights.append(
        Light(middle + 120 * away, middle, spread, warm_white(rng) * strength, False, softness)
    )


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
) -> list[tuple[Mesh, object]]:
    """A building's front towards -y: body, rows of windows with frames, cornices, a door."""
    rng = builder.rng
    body = builder.material(3.0, plain=0.25, gloss=0.0)
    trim = builder.material(0.5, plain=0.8)
    glass = builder.material(0.8, plain=0.8, tint=tuple(rng.uniform(0.01, 0.15, 3)), gloss=0.8)
    parts: list[tuple[Mesh, object]] = [(box((wide, deep, tall), (0, deep / 2, tall / 2)), body)]
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
    crown, tufted = [], rng.random() < 0.45
    for _ in range(int(rng.integers(5, 12))):
        share = rng.uniform(0.4, 0.75)
        root, out = lean * tall * share, rng.normal(0, 1, 3) * [1, 1, 0.4] + [0, 0, 0.6]
        tip = root + out / np.linalg.norm(out) * tall * rng.uniform(0.15, 0.3)
        trunk.append(tube(np.linspace(root, tip, 4), tall * 0.012, 5))
        if tufted:
            crown.append(leafage(rng, tall * 0.2, 14).placed(tip, random_turn(rng)))
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


def street(builder: SceneBuilder) -> Stage:
    """Ground, one or two rows of facades, trees, railings, a statue or two."""
    rng = builder.rng
    sky(builder)
    builder.add(
        terrain(rng, 90, rng.uniform(0, 0.04)), builder.material(3.0, plain=0.05, stain=0.2)
    )
    distance = rng.uniform(4, 14)
    rows = int(rng.integers(1, 4))
    for row in range(rows):
        turn = [0.0, np.pi / 2, -np.pi / 2][row] + rng.normal(0, 0.08)
        x = -14.0
        while x < 14:
            wide, tall = rng.uniform(4, 14), rng.uniform(3, 14)
            back = distance + rng.choice([0.0, rng.uniform(-1, 1.5)])
            for mesh, look in facade(builder, wide, tall, 6.0):
                placed = mesh.placed((x + wide / 2, back + row * 4, 0))
                builder.add(placed.placed((0, 0, 0), spin(turn)), look)  # type: ignore[arg-type]
            x += wide + rng.choice([0.0, rng.uniform(0, 4)])
    for _ in range(int(rng.integers(0, 4))):
        tree(builder, np.array([rng.uniform(-8, 8), rng.uniform(0.3, 0.9) * distance, 0]))
    if rng.random() < 0.4:
        rail(builder, np.array([0, distance * rng.uniform(0.4, 0.9), 0]), rng.normal(0, 0.2), 12)
    for _ in range(int(rng.integers(0, 7))):
        spot = np.array([rng.uniform(-5, 5), rng.uniform(0.3, 0.95) * distance, 0])
        add_thing(builder, spot, rng.uniform(0.3, 1.6))
    backdrop(builder)

    def viewpoint(draw: np.random.Generator) -> tuple[Vector, Vector]:
        eye = np.array(
            [draw.uniform(-4, 4), draw.uniform(-0.6, 0.35) * distance, draw.uniform(1.2, 2.2)]
        )
        target = np.array([draw.uniform(-5, 5), distance, draw.uniform(1, 4)])
        return eye, target

    low, high = np.array([-12.0, -10.0, 0.5]), np.array([12.0, distance - 1.0, 6.0])
    return Stage(viewpoint, low, high, orbit=0.45)


def garden(builder: SceneBuilder) -> Stage:
    """A statue, rock, bush or plant on open ground with others around."""
    rng = builder.rng
    sky(builder)
    ground = builder.material(2.0, plain=0.05, stain=0.25, bump=0.4, bump_scale=0.3)
    builder.add(terrain(rng, 90, rng.uniform(0, 0.25)), ground)
    main = rng.uniform(0.6, 3.0)
    kind = rng.random()
    stone = builder.material(main * 0.6, plain=0.2, triplanar=True, bump=0.5, stain=0.2)
    foot = 0.0
    if rng.random() < 0.5:
        foot = main * rng.uniform(0.2, 0.6)
        plinth = box((main * 0.7, main * 0.7, foot), (0, 0, foot / 2))
        if rng.random() < 0.5:
            r = main * np.array([0.6, 0.6, 0.45, 0.5, 0.0])
            plinth = lathe(np.stack([r, foot * np.array([0, 0.3, 0.35, 1, 1])], 1))
        builder.add(plinth, builder.material(1.0, plain=0.2, bump=0.3))
    if kind < 0.4:
        builder.add(figure(rng, main).placed((0, 0, foot)), stone)
    elif kind < 0.65:
        builder.add(
            lump(rng, main * rng.uniform(0.25, 0.5, 3), 0.7, 30).placed((0, 0, foot + main * 0.3)),
            stone,
        )
    elif kind < 0.85:
        add_thing(builder, np.array([0, 0, foot]), main)
    else:
        tree(builder, np.array([0.0, 0.0, 0.0]))
    for _ in range(int(rng.integers(2, 12))):
        turn, far = rng.uniform(0, 2 * np.pi), main * np.exp(rng.uniform(0, 2.2))
        spot = np.array([far * np.cos(turn), far * np.sin(turn), -0.05])
        pick = rng.random()
        if pick < 0.3 and far > 2:
            tree(builder, spot)
        elif pick < 0.5:
            green = builder.material(0.5, plain=0.3, tint=(0.3, 0.6, 0.12))
            builder.add(leafage(rng, main * rng.uniform(0.3, 0.8), 30).placed(spot), green)
        else:
            add_thing(builder, spot, main * rng.uniform(0.2, 0.9))
    if rng.random() < 0.4:
        rail(builder, np.array([0, main * 2.5, 0]), rng.normal(0, 0.4), 14)
    if rng.random() < 0.4:
        for mesh, look in facade(builder, rng.uniform(8, 20), rng.uniform(4, 10), 6.0):
            builder.add(mesh.placed((0, main * 2 + rng.uniform(3, 10), 0)), look)  # type: ignore[arg-type]
    backdrop(builder)

    def viewpoint(draw: np.random.Generator) -> tuple[Vector, Vector]:
        turn, climb = draw.uniform(0, 2 * np.pi), draw.uniform(0.0, 0.6)
        distance = main * draw.uniform(1.3, 3.5)
        centre = np.array([0, 0, foot + main * draw.uniform(0.3, 0.6)])
        away = np.array([np.cos(turn) * np.cos(climb), np.sin(turn) * np.cos(climb), np.sin(climb)])
        return centre + distance * away, centre + draw.normal(0, 0.05, 3) * main

    reach = 4 * main
    return Stage(viewpoint, np.array([-reach, -reach, 0.3]), np.array([reach, reach, reach]), 0.75)


def relief(builder: SceneBuilder) -> Stage:
    """A bumpy wall, cloth or rock face that fills the picture, with things before it."""
    rng = builder.rng
    sky(builder)
    builder.add(terrain(rng, 60, 0.05), builder.material(2.0, plain=0.1))
    cells, wide = 72, rng.uniform(3, 8)
    field = spectral(rng, (cells, cells), rng.uniform(1.3, 2.3), rng.uniform(1, 5))
    x, z = np.meshgrid(np.linspace(-wide / 2, wide / 2, cells), np.linspace(0, wide * 0.7, cells))
    steps = rng.random() < 0.3
    depth = np.round(field * 2) / 2 if steps else field
    y = -rng.uniform(0.03, 0.3) * depth + rng.normal(0, 0.2) * x
    wall = surface(np.stack([x, y, z], -1), np.stack([x, z], -1))
    builder.add(wall, builder.material(1.5, plain=0.05, bump=float(rng.uniform(0, 0.6)), stain=0.2))
    for _ in range(int(rng.integers(1, 14))):
        at = np.array(
            [rng.uniform(-0.4, 0.4) * wide, rng.uniform(-1.6, 0.0), rng.uniform(0, 0.5) * wide]
        )
        if rng.random() < 0.5:
            add_thing(builder, at * [1, 1, 0], rng.uniform(0.2, 1.0))
        else:  # something hung on the wall
            at[1] = -0.1
            add_thing(builder, at, rng.uniform(0.1, 0.5))
    if rng.random() < 0.4:
        rail(builder, np.array([0, -1.0, 0]), rng.normal(0, 0.2), wide)
    backdrop(builder)

    def viewpoint(draw: np.random.Generator) -> tuple[Vector, Vector]:
        target = np.array([draw.uniform(-0.2, 0.2) * wide, 0, draw.uniform(0.1, 0.45) * wide])
        eye = np.array(
            [draw.uniform(-0.3, 0.3) * wide, -draw.uniform(1.5, 4), draw.uniform(0.4, 2.0)]
        )
        return eye, target

    return Stage(viewpoint, np.array([-wide, -6.0, 0.2]), np.array([wide, -0.5, wide]), 0.5)


def clutter(builder: SceneBuilder) -> Stage:
    """A heap of unrelated shapes in a box of pictures: nothing to recognise, all geometry."""
    rng = builder.rng
    reach = 4.0
    for axis in range(3):
        for side in (-1.0, 1.0):
            origin, u, v = np.full(3, -reach), np.zeros(3), np.zeros(3)
            origin[axis] = side * reach
            u[(axis + 1) % 3] = v[(axis + 2) % 3] = 2 * reach
            builder.add(quad(origin, u, v), builder.material(4.0, plain=0.1, casts=False))
    for _ in range(int(rng.integers(12, 40))):
        at, size = rng.uniform(-2.6, 2.6, 3), float(np.exp(rng.uniform(-1.8, 0.3)))
        add_thing(builder, at, size)
    from styl3r_export.scenes.indoors import room_lights

    room_lights(builder, np.array([6.0, 6.0, 4.0]))

    def viewpoint(draw: np.random.Generator) -> tuple[Vector, Vector]:
        return draw.uniform(-3.4, 3.4, 3), draw.normal(0, 0.6, 3)

    return Stage(viewpoint, np.full(3, -3.6), np.full(3, 3.6), orbit=0.5)
