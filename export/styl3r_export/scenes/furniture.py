"""Furniture from boards, legs and cushions; each piece stands on the floor of its room."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.builder import Material, SceneBuilder
from styl3r_export.scenes.meshes import Mesh, box, merged, quad, spin
from styl3r_export.scenes.solids import blob, cylinder
from styl3r_export.scenes.things import add_thing, leafage, vessel

Vector = NDArray[np.float64]


def _put(builder: SceneBuilder, parts: list[Mesh], at: Vector, turn: float, look: Material) -> None:
    builder.add(merged(parts).placed(at, spin(turn)), look)


def _strew(
    builder: SceneBuilder, at: Vector, turn: float, half: Vector, top: float, most: int
) -> None:
    """Things on a board of half size `half` whose surface is at height top."""
    rng = builder.rng
    for _ in range(int(rng.integers(0, most + 1))):
        spot = np.array([*(rng.uniform(-0.85, 0.85, 2) * half), top])
        add_thing(builder, at + spin(turn) @ spot, float(np.exp(rng.uniform(-2.6, -0.9))))


def _legs(rng: np.random.Generator, half: Vector, height: float) -> list[Mesh]:
    thick, inset = rng.uniform(0.025, 0.08), rng.uniform(0.8, 1.0)
    round_legs = rng.random() < 0.4
    made = []
    for sx in (-1, 1):
        for sy in (-1, 1):
            foot = (sx * inset * (half[0] - thick), sy * inset * (half[1] - thick), 0)
            leg = cylinder(thick / 2, height, thick / 1.5, 10) if round_legs else None
            leg = leg or box((thick, thick, height), (0, 0, height / 2))
            made.append(leg.placed(foot))
    return made


def table(builder: SceneBuilder, at: Vector, turn: float) -> None:
    """A table or desk with legs and things on it."""
    rng = builder.rng
    half = np.array([rng.uniform(0.4, 1.1), rng.uniform(0.3, 0.6)])
    height, thick = rng.uniform(0.4, 0.85), rng.uniform(0.02, 0.07)
    board = box((2 * half[0], 2 * half[1], thick), (0, 0, height))
    if rng.random() < 0.25:
        half[:] = half.mean()
        board = cylinder(half[0], thick, sides=32).placed((0, 0, height - thick / 2))
    look = builder.material(1.5)
    _put(builder, [board], at, turn, look)
    feet = look if rng.random() < 0.6 else builder.material(0.5)
    _put(builder, _legs(rng, 0.85 * half, height), at, turn, feet)
    _strew(builder, at, turn, half * 0.8, height + thick / 2, 7)


def chair(builder: SceneBuilder, at: Vector, turn: float) -> None:
    """A chair or stool."""
    rng = builder.rng
    half, height = np.array([0.22, 0.22]) * rng.uniform(0.9, 1.2), rng.uniform(0.4, 0.5)
    parts = [box((2 * half[0], 2 * half[1], 0.04), (0, 0, height)), *_legs(rng, half, height)]
    if rng.random() < 0.85:
        back = rng.uniform(0.35, 0.6)
        bars = int(rng.integers(1, 6))
        for k in range(bars):
            wide = 2 * half[0] / bars * rng.uniform(0.4, 1.0)
            x = (k + 0.5) / bars * 2 * half[0] - half[0]
            parts.append(box((wide, 0.03, back), (x, half[1], height + back / 2)))
        parts.append(box((2 * half[0], 0.035, 0.06), (0, half[1], height + back)))
    _put(builder, parts, at, turn, builder.material(0.6))


def shelf(builder: SceneBuilder, at: Vector, turn: float) -> None:
    """Shelves with rows of books and things."""
    rng = builder.rng
    wide, deep, tall = rng.uniform(0.6, 1.8), rng.uniform(0.22, 0.4), rng.uniform(0.7, 2.2)
    levels, thick = int(rng.integers(2, 6)), 0.025
    parts = [box((thick, deep, tall), (s * wide / 2, 0, tall / 2)) for s in (-1, 1)] + [
        box((wide, deep, thick), (0, 0, tall * k / levels)) for k in range(levels + 1)
    ]
    if rng.random() < 0.6:
        parts.append(box((wide, 0.01, tall), (0, deep / 2, tall / 2)))
    _put(builder, parts, at, turn, builder.material(1.0))
    gap = tall / levels
    for k in range(levels):
        z = tall * k / levels + thick / 2
        if rng.random() < 0.5:
            x = -wide / 2 + 0.03
            look = builder.material(0.4, scale=float(rng.uniform(0.25, 0.6)))
            row = []
            while x < wide / 2 * rng.uniform(0.2, 1.0):
                w, h = rng.uniform(0.015, 0.06), gap * rng.uniform(0.5, 0.88)
                row.append(box((w, deep * 0.7, h), (x + w / 2, -0.02, z + h / 2)))
                x += w + 0.002
            if row:
                _put(builder, row, at, turn, look)
        else:
            spot = at + np.array([0, 0, z])
            for _ in range(int(rng.integers(0, 4))):
                place = spin(turn) @ np.array([rng.uniform(-0.42, 0.42) * wide, 0, 0])
                add_thing(builder, spot + place, gap * rng.uniform(0.2, 0.6))


def sofa(builder: SceneBuilder, at: Vector, turn: float) -> None:
    """A sofa, armchair or bed: soft bodies with cushions."""
    rng = builder.rng
    wide, deep, seat = rng.uniform(0.8, 2.2), rng.uniform(0.75, 1.0), rng.uniform(0.35, 0.5)
    soft = rng.uniform(0.15, 0.4)

    def body(x: float, y: float, z: float, where: tuple[float, float, float]) -> Mesh:
        return blob((x / 2, y / 2, z / 2), None, 12, soft).placed(where)

    parts = [
        body(wide, deep, seat, (0, 0, seat / 2)),
        body(wide, 0.25, seat * 2, (0, deep / 2, seat)),
        *(body(0.2, deep, seat * 1.5, (s * wide / 2, 0, seat * 0.75)) for s in (-1, 1)),
    ]
    _put(builder, parts, at, turn, builder.material(1.2, triplanar=True, gloss=0.0))
    for _ in range(int(rng.integers(0, 4))):
        pillow = blob((0.22, 0.08, 0.2), None, 12, 0.5).placed(
            (0, 0, 0), spin(rng.normal(0, 0.3), 0)
        )
        where = spin(turn) @ np.array([rng.uniform(-0.4, 0.4) * wide, deep * 0.25, seat + 0.18])
        builder.add(pillow.placed(at + where, spin(turn)), builder.material(0.4, gloss=0.0))


def cabinet(builder: SceneBuilder, at: Vector, turn: float) -> None:
    """A cupboard, chest of drawers or kitchen unit with doors and handles."""
    rng = builder.rng
    wide, deep, tall = rng.uniform(0.5, 1.8), rng.uniform(0.35, 0.6), rng.uniform(0.5, 1.9)
    _put(builder, [box((wide, deep, tall), (0, 0, tall / 2))], at, turn, builder.material(1.0))
    columns, rows = int(rng.integers(1, 5)), int(rng.integers(1, 4))
    doors, knobs = [], []
    for i in range(columns):
        for k in range(rows):
            x, z = ((i + 0.5) / columns - 0.5) * wide, (k + 0.5) / rows * tall
            doors.append(box((wide / columns * 0.93, 0.02, tall / rows * 0.93), (x, -deep / 2, z)))
            knobs.append(box((0.1, 0.03, 0.015), (x, -deep / 2 - 0.02, z + tall / rows * 0.3)))
    _put(builder, doors, at, turn, builder.material(0.6))
    _put(builder, knobs, at, turn, builder.material(0.1, plain=0.9))
    if tall < 1.3:
        _strew(builder, at, turn, np.array([wide, deep]) * 0.42, tall, 5)


def plant(builder: SceneBuilder, at: Vector, turn: float) -> None:
    """A plant in a pot."""
    rng = builder.rng
    size = rng.uniform(0.2, 0.5)
    pot = vessel(rng, size * 0.4, size * 0.7)
    builder.add(pot.placed(at), builder.material(0.3))
    green = np.array([0.10, 0.25, 0.05]) * np.exp(rng.normal(0, 0.4, 3))
    look = builder.material(0.3, plain=0.0, tint=tuple(3 * green), gloss=0.15)
    if rng.random() < 0.5:
        look = builder.material(0.3, plain=1.0, tint=tuple(green), stain=0.3, stain_scale=0.1)
    crown = leafage(rng, size * rng.uniform(1.0, 3.0), int(rng.integers(14, 50)))
    builder.add(crown.placed(at + np.array([0, 0, size * 0.6]), spin(turn)), look)


def standing_lamp(builder: SceneBuilder, at: Vector, turn: float) -> None:
    """A thin pole with a shade."""
    rng = builder.rng
    height = rng.uniform(0.5, 1.8)
    pole = [cylinder(0.15, 0.03), cylinder(0.012, height, sides=8)]
    _put(builder, pole, at, turn, builder.material(0.2, plain=0.9))
    shade = cylinder(rng.uniform(0.12, 0.25), 0.25, rng.uniform(0.05, 0.2))
    warm = tuple(np.array([1.0, 0.85, 0.6]) * rng.uniform(0.5, 1.6))
    look = builder.material(0.3, tint=warm, glow=bool(rng.random() < 0.5))
    builder.add(shade.placed(at + np.array([0, 0, height - 0.05])), look)


def screen(builder: SceneBuilder, at: Vector, turn: float) -> None:
    """A monitor or framed panel on a stand, on a small desk."""
    rng = builder.rng
    height, wide = rng.uniform(0.6, 0.8), rng.uniform(0.4, 0.9)
    half = np.array([rng.uniform(0.5, 0.9), 0.35])
    desk = [box((2 * half[0], 2 * half[1], 0.04), (0, 0, height)), *_legs(rng, half, height)]
    _put(builder, desk, at, turn, builder.material(1.2))
    frame = [
        box((wide, 0.04, wide * 0.6), (0, 0.1, height + 0.12 + wide * 0.3)),
        box((0.05, 0.05, 0.2), (0, 0.12, height + 0.1)),
        box((0.25, 0.2, 0.015), (0, 0.12, height + 0.028)),
    ]
    _put(builder, frame, at, turn, builder.material(0.4, plain=1.0, tint=(0.02, 0.02, 0.02)))
    face = quad((-wide * 0.48, 0.078, height + 0.13), (wide * 0.96, 0, 0), (0, 0, wide * 0.56))
    look = builder.material(wide, plain=0.0, scale=wide, glow=bool(rng.random() < 0.5))
    builder.add(face.placed(at, spin(turn)), look)
    _strew(builder, at, turn, half * np.array([0.9, 0.5]), height + 0.02, 6)


#: Every piece and how often it is chosen.
PIECES: list[tuple[Callable[[SceneBuilder, Vector, float], None], float]] = [
    (table, 3), (chair, 2), (shelf, 2), (sofa, 2), (cabinet, 2), (plant, 1.5),
    (standing_lamp, 1), (screen, 1.5),
]  # fmt: skip


def add_piece(builder: SceneBuilder, at: Vector, turn: float) -> None:
    """Stand a random piece of furniture; its back is towards +y before the turn."""
    weights = np.array([w for _, w in PIECES])
    PIECES[int(builder.rng.choice(len(PIECES), p=weights / weights.sum()))][0](builder, at, turn)
