"""Streets, gardens with a statue or rock, and rough walls seen close, under a sky."""

import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.builder import SceneBuilder, Stage
from styl3r_export.scenes.meshes import box, spin, surface
from styl3r_export.scenes.noise import spectral
from styl3r_export.scenes.outdoor_pieces import backdrop, facade, rail, sky, terrain, tree
from styl3r_export.scenes.solids import lathe
from styl3r_export.scenes.things import add_thing, figure, leafage, lump

Vector = NDArray[np.float64]


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
                builder.add(placed.placed((0, 0, 0), spin(turn)), look)
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
            builder.add(mesh.placed((0, main * 2 + rng.uniform(3, 10), 0)), look)
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
    field = spectral(rng, (cells, cells), rng.uniform(1.6, 2.4), rng.uniform(1, 5))
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
