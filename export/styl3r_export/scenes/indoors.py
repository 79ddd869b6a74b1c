"""Rooms with furniture, and things on a table top in front of a backdrop."""

import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.builder import Light, SceneBuilder, Stage
from styl3r_export.scenes.furniture import add_piece
from styl3r_export.scenes.meshes import Mesh, box, merged, quad, spin
from styl3r_export.scenes.solids import cylinder
from styl3r_export.scenes.things import add_thing

Vector = NDArray[np.float64]


def warm_white(rng: np.random.Generator) -> Vector:
    """Colour of a lamp or of daylight: along the black body line, normalised green."""
    warmth = rng.normal(0.08, 0.2)
    return np.array([np.exp(0.8 * warmth), 1.0, np.exp(-1.3 * warmth)])


def room_lights(builder: SceneBuilder, size: Vector) -> None:
    """A ceiling lamp, light through a window, and their bounce as ambient light."""
    rng = builder.rng
    x, y, z = size
    share = rng.uniform(0.25, 0.8)
    tone = warm_white(rng)
    builder.ambient = np.stack([tone * rng.uniform(0.7, 1.0), tone * rng.uniform(0.4, 0.9)]) * share
    if rng.random() < 0.8:
        at = np.array([rng.uniform(-0.3, 0.3) * x, rng.uniform(-0.3, 0.3) * y, z * 0.97])
        strength = rng.uniform(1.0, 4.0) * (1 - share)
        below = at * [1, 1, 0] + [*rng.normal(0, 0.3, 2), 0]
        spread = rng.uniform(2.2, 2.7)
        builder.lights.append(
            Light(at, below, spread, warm_white(rng) * strength * 2.0, True, rng.uniform(2, 9))
        )
    if rng.random() < 0.8:
        turn, climb = rng.uniform(0, 2 * np.pi), rng.uniform(0.3, 1.0)
        toward = np.array(
            [np.cos(turn) * np.cos(climb), np.sin(turn) * np.cos(climb), np.sin(climb)]
        )
        reach = float(np.linalg.norm(size)) * 4
        spread = 2 * np.arctan(0.62 / 4)
        middle = np.array([0, 0, z / 3])
        strength = rng.uniform(0.3, 1.6)
        builder.lights.append(
            Light(
                middle + toward * reach,
                middle,
                spread,
                warm_white(rng) * strength,
                False,
                rng.uniform(0.8, 10),
            )
        )


def _wall_fittings(
    builder: SceneBuilder, start: Vector, along: Vector, wide: float, tall: float
) -> None:
    """Pictures, windows, a door, sockets and trims on one wall."""
    rng = builder.rng
    inward = np.cross(np.array([0, 0, 1.0]), along)
    turn = np.arctan2(along[1], along[0])

    def panel(x: float, z: float, w: float, h: float, deep: float) -> Mesh:
        return box((w, deep, h), (x, 0, z)).placed(start, spin(turn))

    def face(x: float, z: float, w: float, h: float, off: float) -> Mesh:
        origin = start + along * (x - w / 2) + np.array([0, 0, z - h / 2]) + inward * off
        return quad(origin, along * w, (0, 0, h))

    if rng.random() < 0.7:
        skirting = panel(wide / 2, 0.05, wide, 0.1, 0.04)
        builder.add(skirting, builder.material(0.3, plain=0.9))
    x = rng.uniform(0.2, 1.0)
    while x < wide - 0.4:
        kind, w = rng.random(), rng.uniform(0.3, 1.3)
        z, h = tall * rng.uniform(0.45, 0.65), min(w * rng.uniform(0.6, 1.5), 0.6 * tall)
        if x + w > wide - 0.1:
            break
        centre = x + w / 2
        if kind < 0.35:  # picture
            builder.add(panel(centre, z, w, h, 0.05), builder.material(0.5, plain=0.7))
            inner = face(centre, z, w * 0.9, h - 0.1 * w, 0.028)
            builder.add(inner, builder.material(w, plain=0.0, scale=max(w, h)))
        elif kind < 0.6:  # window with bars
            h = tall * rng.uniform(0.35, 0.6)
            bright = tuple(rng.uniform(1.0, 3.0) * np.array([0.95, 1.0, 1.05]))
            view = builder.material(w, plain=0.3, scale=max(w, h), tint=bright, glow=True)
            builder.add(face(centre, z, w, h, 0.01), view)
            bars = [panel(centre + s * w / 2, z, 0.06, h, 0.1) for s in (-1, 0, 1)]
            bars += [panel(centre, z + s * h / 2, w, 0.06, 0.1) for s in (-1, 0.2, 1)]
            builder.add(merged(bars), builder.material(0.3, plain=0.9))
        elif kind < 0.75:  # door
            h, w = 0.78 * tall, 0.85
            builder.add(
                panel(x + w / 2, h / 2, w + 0.15, h + 0.08, 0.06), builder.material(1, plain=0.9)
            )
            builder.add(panel(x + w / 2, h / 2, w, h, 0.08), builder.material(1.0, plain=0.5))
        elif kind < 0.9:  # small board with things
            builder.add(panel(centre, z, w, 0.03, 0.4), builder.material(1.0))
            for _ in range(int(rng.integers(1, 5))):
                spot = start + along * (x + rng.uniform(0.1, 0.9) * w) + inward * 0.1
                add_thing(builder, spot + np.array([0, 0, z + 0.015]), rng.uniform(0.1, 0.35))
        x += w + rng.uniform(0.1, 1.2)


def room(builder: SceneBuilder) -> Stage:
    """A room with 2 to 4 walls, fittings and furniture along the walls and in the middle."""
    rng = builder.rng
    size = np.array([rng.uniform(2.5, 7), rng.uniform(2.5, 7), rng.uniform(2.2, 3.4)])
    hx, hy, z = size[0] / 2, size[1] / 2, size[2]
    floor = quad((-hx, -hy, 0), (2 * hx, 0, 0), (0, 2 * hy, 0))
    builder.add(floor, builder.material(2.0, plain=0.15, casts=False))
    ceiling = quad((-hx, -hy, z), (0, 2 * hy, 0), (2 * hx, 0, 0))
    builder.add(ceiling, builder.material(2.0, plain=0.7, casts=False))
    corners = np.array([[-hx, -hy, 0], [hx, -hy, 0], [hx, hy, 0], [-hx, hy, 0]])
    shared = builder.material(2.0, plain=0.6, casts=False)
    for k in range(4):
        start, end = corners[k], corners[(k + 1) % 4]
        wide = float(np.linalg.norm(end - start))
        along = (end - start) / wide
        other = rng.random() < 0.3
        look = builder.material(2.0, plain=0.4, casts=False) if other else shared
        builder.add(quad(start, end - start, (0, 0, z)), look)
        _wall_fittings(builder, start, along, wide, z)
        inward = np.array([-along[1], along[0], 0])
        x = rng.uniform(0.3, 1.2)
        while x < wide - 0.6:
            if rng.random() < 0.75:
                spot = start + along * (x + 0.4) + inward * rng.uniform(0.32, 0.6)
                add_piece(builder, spot, float(np.arctan2(inward[1], inward[0])) + np.pi / 2)
            x += rng.uniform(0.9, 2.2)
    spots = [np.array([0.0, 0.0, 1.0])]
    for _ in range(int(rng.integers(1, 5))):
        spot = np.array([rng.uniform(-0.5, 0.5) * hx, rng.uniform(-0.5, 0.5) * hy, 0])
        add_piece(builder, spot, rng.uniform(0, 2 * np.pi))
        spots.append(spot + np.array([0, 0, 0.7]))
    if rng.random() < 0.4:
        rug = cylinder(1.0, 0.012) if rng.random() < 0.3 else box((2.0, 1.4, 0.02))
        builder.add(
            rug.placed((*rng.uniform(-0.5, 0.5, 2), 0.006)), builder.material(1.5, plain=0.0)
        )
    for _ in range(int(rng.integers(0, 6))):
        spot = np.array([*rng.uniform(-0.8, 0.8, 2) * [hx, hy], 0])
        add_thing(builder, spot, rng.uniform(0.15, 0.6))
    room_lights(builder, size)

    def viewpoint(draw: np.random.Generator) -> tuple[Vector, Vector]:
        eye = np.array([*(draw.uniform(-0.85, 0.85, 2) * [hx, hy]), draw.uniform(0.7, 1.75)])
        if draw.random() < 0.5:
            target = spots[int(draw.integers(len(spots)))] + draw.normal(0, 0.3, 3)
        else:
            side = draw.uniform(0, 2 * np.pi)
            target = np.array([np.cos(side) * hx, np.sin(side) * hy, draw.uniform(0.5, 1.5)])
        return eye, target

    low, high = np.array([-hx, -hy, 0.0]), np.array([hx, hy, z])
    return Stage(viewpoint, low + 0.15, high - 0.15, orbit=0.4)


def tabletop(builder: SceneBuilder) -> Stage:
    """Things close together on a board, with a wall or a blurred room behind."""
    rng = builder.rng
    half, back = rng.uniform(0.5, 1.2), rng.uniform(0.5, 2.5)
    board = quad((-half, -half, 0), (2 * half, 0, 0), (0, 2 * half, 0))
    if rng.random() < 0.3:
        board = cylinder(half, 0.03, sides=40).placed((0, 0, -0.03))
    builder.add(board, builder.material(1.0, plain=0.15))
    reach = half + back
    floor = quad((-reach, -reach, -0.75), (2 * reach, 0, 0), (0, 2 * reach, 0))
    builder.add(floor, builder.material(2.0, casts=False))
    for k in range(4):
        turn = spin(k * np.pi / 2)
        wall = quad((-reach, reach, -0.75), (2 * reach, 0, 0), (0, 0, 3.0))
        builder.add(wall.placed((0, 0, 0), turn), builder.material(2.0, plain=0.3, casts=False))
        for _ in range(int(rng.integers(0, 4))):
            spot = turn @ np.array(
                [rng.uniform(-0.8, 0.8) * reach, rng.uniform(0.75, 0.95) * reach, -0.75]
            )
            add_piece(builder, spot, float(k * np.pi / 2))
    ceiling = quad((-reach, -reach, 2.25), (0, 2 * reach, 0), (2 * reach, 0, 0))
    builder.add(ceiling, builder.material(2.0, plain=0.8, casts=False))
    main = rng.uniform(0.15, 0.5)
    add_thing(builder, np.zeros(3), main)
    for _ in range(int(rng.integers(1, 14))):
        spot = np.array([*(rng.normal(0, 0.45 * half, 2)), 0.0])
        if np.abs(spot).max() < half:
            add_thing(builder, spot, float(np.exp(rng.uniform(-2.8, -0.9))))
    if rng.random() < 0.3:
        cloth = box((rng.uniform(0.3, 0.9), rng.uniform(0.3, 0.9), 0.006))
        builder.add(
            cloth.placed((0, 0, 0.003), spin(rng.uniform(0, 3))), builder.material(0.5, plain=0)
        )
    room_lights(builder, np.array([2 * reach, 2 * reach, 2.2]))

    def viewpoint(draw: np.random.Generator) -> tuple[Vector, Vector]:
        turn, climb = draw.uniform(0, 2 * np.pi), draw.uniform(0.12, 1.0)
        distance = main * draw.uniform(1.4, 3.6)
        centre = np.array([*draw.normal(0, 0.06, 2), main * draw.uniform(0.2, 0.6)])
        away = np.array([np.cos(turn) * np.cos(climb), np.sin(turn) * np.cos(climb), np.sin(climb)])
        return centre + distance * away, centre

    low, high = np.array([-reach, -reach, 0.06]), np.array([reach, reach, 2.2])
    return Stage(viewpoint, low, high, orbit=0.8)


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
    room_lights(builder, np.array([6.0, 6.0, 4.0]))

    def viewpoint(draw: np.random.Generator) -> tuple[Vector, Vector]:
        return draw.uniform(-3.4, 3.4, 3), draw.normal(0, 0.6, 3)

    return Stage(viewpoint, np.full(3, -3.6), np.full(3, 3.6), orbit=0.5)
