"""Small things: pots, bottles, cups, fruit, books, balls, figures, plants, lumps."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.builder import SceneBuilder
from styl3r_export.scenes.meshes import QUAD, Mesh, box, merged, random_turn, sheets, spin
from styl3r_export.scenes.solids import blob, cylinder, lathe, torus, tube

Vector = NDArray[np.float64]
#: Corners of a leaf in its texture.
QUAD_UV = np.array([[0.0, 1.0], [1.0, 0.5], [2.0, 1.0], [1.0, 1.5]])


def lump(rng: np.random.Generator, radii: Vector, roughness: float, rings: int = 16) -> Mesh:
    """A pebble, bush or carved-looking form: an ellipsoid swollen by a few random waves."""
    count = int(rng.integers(4, 14))
    waves = rng.normal(size=(count, 3)) * rng.uniform(1.0, 5.0, (count, 1))
    phases = rng.uniform(0, 2 * np.pi, count)
    heights = roughness * rng.uniform(0.3, 1.0, count) / np.sqrt(count)

    def swell(unit: Vector) -> Vector:
        return np.maximum(1 + (np.sin(unit @ waves.T + phases) * heights).sum(-1), 0.3)

    return blob(radii, swell, rings)


def vessel(rng: np.random.Generator, radius: float, height: float) -> Mesh:
    """A vase, bowl, bottle or lamp foot: a smooth random profile turned about z."""
    knots = rng.uniform(0.35, 1.0, int(rng.integers(3, 7)))
    if rng.random() < 0.3:  # a bottle's neck
        knots[-2:] = rng.uniform(0.2, 0.35)
    t = np.linspace(0, 1, 15)
    r = np.interp(t, np.linspace(0, 1, len(knots)), knots)
    r = np.convolve(np.pad(r, 1, mode="edge"), [0.25, 0.5, 0.25], "valid")
    outer = np.stack([radius * r, height * t], 1)
    inner = np.stack([0.85 * radius * r[::-1], height * t[::-1]], 1)[:8]
    return lathe(np.concatenate([[[0.0, 0.0]], outer, inner]), int(rng.choice([6, 20, 24, 28])))


def figure(rng: np.random.Generator, height: float) -> Mesh:
    """A statue-like stack of lumps with limbs."""
    parts, z = [], 0.0
    while z < height:
        r = height * rng.uniform(0.10, 0.22)
        tall = r * rng.uniform(0.8, 1.8)
        shift = [*rng.normal(0, 0.03 * height, 2), z + tall * 0.7]
        size = np.array([r, r * rng.uniform(0.6, 1.0), tall])
        parts.append(
            lump(rng, size, rng.uniform(0.0, 0.4), 12).placed(shift, spin(rng.uniform(0, 6)))
        )
        z += tall * 1.3
    for _ in range(int(rng.integers(0, 5))):
        start = np.array([0, 0, rng.uniform(0.2, 0.9) * height])
        bend = np.cumsum(rng.normal(0, 0.12 * height, (5, 3)), 0)
        parts.append(tube(start + bend, height * np.linspace(0.06, 0.03, 5), 8))
    return merged(parts)


def bolt(rng: np.random.Generator, size: float) -> Mesh:
    """A machine-like toy: boxes, discs and rods along its axes."""
    parts = []
    for _ in range(int(rng.integers(5, 14))):
        at = rng.uniform(-0.5, 0.5, 3) * size * np.array([1, 0.6, 0.6]) + [0, 0, size * 0.4]
        kind, axis = rng.random(), int(rng.integers(0, 3))
        if kind < 0.5:
            mesh = box(size * rng.uniform(0.08, 0.6, 3))
        elif kind < 0.75:
            mesh = cylinder(size * rng.uniform(0.05, 0.25), size * rng.uniform(0.05, 0.4), sides=14)
        else:
            mesh = torus(size * rng.uniform(0.1, 0.25), size * rng.uniform(0.02, 0.07), 16)
        parts.append(mesh.placed(at, spin(np.pi / 2, axis)))
    return merged(parts)


def book(rng: np.random.Generator, size: float) -> Mesh:
    """A book, box or brick lying flat."""
    x, y = size * rng.uniform(0.5, 1.0, 2)
    return box((x, y, z := size * rng.uniform(0.08, 0.9)), (0, 0, z / 2))


def leafage(rng: np.random.Generator, height: float, count: int = 24) -> Mesh:
    """Arching leaves from one foot: a fern, grass tuft or pot plant."""
    wide, droop = height * rng.uniform(0.02, 0.12), rng.uniform(0.2, 1.6)
    stem = rng.uniform(0.0, 0.5) if rng.random() < 0.5 else 0.0

    def each(low: float, high: float) -> Vector:
        return rng.uniform(low, high, (count, 1))

    t = np.linspace(0, 1, 6)[None]
    bend = each(0.2, 1.3) - droop * t
    length = height * each(0.4, 1.0)
    out = np.cumsum(np.cos(bend), 1) * length / 6
    up = np.cumsum(np.sin(bend), 1) * length / 6 + stem * height * each(0, 1)
    half = wide * np.sin(np.pi * np.clip(t * 0.92 + 0.06, 0, 1)) * each(0.7, 1.3)
    turn = 2.4 * np.arange(count)[:, None] + rng.normal(0, 0.2, (count, 1))
    c, s = np.cos(turn), np.sin(turn)
    points = np.empty((count, 6, 3, 3))
    for k, side in enumerate((-1.0, 0.0, 1.0)):  # left edge, rib, right edge
        across = side * half
        points[:, :, k, 0], points[:, :, k, 1] = c * out - s * across, s * out + c * across
        points[:, :, k, 2] = up + 0.3 * half * (side if side else -1.0)
    uv = np.stack(
        np.broadcast_arrays(points[..., 0] * 0 + wide, length[..., None] * t[..., None]), -1
    )
    uv[..., 0] *= np.arange(3)
    parts = [sheets(points, uv)]
    if stem:
        line = np.array([[0, 0, 0], [0.01, 0, stem / 2], [0, 0.01, stem]]) * height
        parts.append(tube(line, 0.03 * height, 6))
    return merged(parts)


def foliage(rng: np.random.Generator, radii: Vector, count: int, leaf: float) -> Mesh:
    """A bush or crown: many small leaves in an ellipsoid, shaded as one soft body."""
    out = rng.normal(size=(count, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    middle = out * radii * rng.uniform(0.25, 1.0, (count, 1)) ** 0.5
    along = rng.normal(size=(count, 3))
    along *= leaf / np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, rng.normal(size=(count, 3)))
    across *= 0.5 * leaf / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    corners = np.stack([middle - along, middle + across, middle + along, middle - across], 1)
    facing = np.cross(across, along)
    facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-9)
    facing *= np.sign((facing * out).sum(1, keepdims=True))
    normals = 0.5 * facing + out
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    uv = rng.uniform(0, 4 * leaf, (count, 1, 2)) + leaf * QUAD_UV
    index = QUAD.reshape(-1)

    def soup(x: Vector, width: int) -> NDArray[np.float32]:
        return x[:, index].reshape(-1, 3, width).astype(np.float32)

    normals = np.broadcast_to(normals[:, None], corners.shape)
    return Mesh(soup(corners, 3), soup(normals, 3), soup(uv, 2))


def wire(rng: np.random.Generator, size: float) -> Mesh:
    """A thin bent rod, cable or twig."""
    steps = rng.normal(0, 1, (9, 3)) * size / 4
    path = np.cumsum(steps + rng.normal(0, size / 12, 3), 0)
    path[:, 2] = np.abs(path[:, 2]) * 0.6
    fine = np.stack(
        [np.interp(np.linspace(0, 8, 25), np.arange(9), path[:, k]) for k in range(3)], 1
    )
    fine = (fine + np.roll(fine, 1, 0) + np.roll(fine, -1, 0))[1:-1] / 3
    return tube(fine, size * rng.uniform(0.008, 0.05), 7)


def chest(rng: np.random.Generator, size: float) -> Mesh:
    """A squarish body with rounded edges: cushions, radios, bread."""
    radii = size * rng.uniform(0.2, 0.5, 3)
    return blob(radii, None, 16, rng.uniform(0.25, 0.8)).placed((0, 0, radii[2]))


def ball(rng: np.random.Generator, size: float) -> Mesh:
    """A ball, egg or fruit standing on the ground."""
    radii = size * np.array([0.5, 0.5, 0.5]) * rng.uniform(0.6, 1.0)
    radii = radii * rng.uniform(0.7, 1.2, 3) if rng.random() < 0.5 else radii
    return blob(radii, None, 18).placed((0, 0, radii[2]))


def pile(rng: np.random.Generator, size: float) -> Mesh:
    """A tilted heap of one shape repeated."""
    parts = []
    for _ in range(int(rng.integers(4, 12))):
        at = np.array([*rng.normal(0, 0.3, 2), rng.uniform(0, 0.5)]) * size
        shape = box(size * rng.uniform(0.1, 0.4, 3))
        if rng.random() < 0.4:
            shape = lump(rng, size * rng.uniform(0.1, 0.25, 3), 0.3, 10)
        parts.append(shape.placed(at, random_turn(rng)))
    return merged(parts)


def _bush(rng: np.random.Generator, size: float) -> Mesh:
    radii = size * rng.uniform(0.3, 0.5, 3)
    leaf = size * rng.uniform(0.03, 0.09)
    return foliage(rng, radii, int(rng.integers(80, 400)), leaf).placed((0, 0, radii[2]))


def _rock(rng: np.random.Generator, size: float) -> Mesh:
    radii = size * rng.uniform(0.25, 0.5, 3)
    return lump(rng, radii, rng.uniform(0.1, 0.6), 20).placed((0, 0, 0.8 * radii[2]))


def _pot(rng: np.random.Generator, size: float) -> Mesh:
    return vessel(rng, size * rng.uniform(0.15, 0.45), size)


def _plant(rng: np.random.Generator, size: float) -> Mesh:
    return leafage(rng, size, int(rng.integers(8, 36)))


def _drum(rng: np.random.Generator, size: float) -> Mesh:
    cone = rng.random() < 0.4
    radius, height = size * rng.uniform(0.1, 0.4), size * rng.uniform(0.2, 1.0)
    return cylinder(radius, height, 0.0 if cone else None)


def _ring(rng: np.random.Generator, size: float) -> Mesh:
    thick = size * rng.uniform(0.04, 0.16)
    return torus(0.38 * size, thick).placed((0, 0, thick))


#: Maker of a thing of a given size standing on z = 0, and how often it is chosen.
THINGS: list[tuple[Callable[[np.random.Generator, float], Mesh], float]] = [
    (book, 3), (_pot, 3), (ball, 2), (_rock, 3), (figure, 2.5), (bolt, 2), (chest, 1.5),
    (_plant, 1.5), (_bush, 1), (_drum, 1.7), (_ring, 0.7), (wire, 1), (pile, 1.2),
]  # fmt: skip


def add_thing(builder: SceneBuilder, position: Vector, size: float) -> None:
    """Stand a random thing of a size somewhere, turned at random."""
    rng = builder.rng
    weights = np.array([w for _, w in THINGS])
    make = THINGS[int(rng.choice(len(THINGS), p=weights / weights.sum()))][0]
    mesh = make(rng, size).placed(position, spin(rng.uniform(0, 2 * np.pi)))
    material = builder.material(size, triplanar=bool(rng.random() < 0.5))
    builder.add(mesh, material)
