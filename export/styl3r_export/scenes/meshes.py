"""Triangle soups: boxes, surfaces over a grid, lathes, tubes and blobs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]
#: Three numbers, or any array of them.
Triple = Sequence[float] | NDArray[np.floating]


@dataclass(frozen=True)
class Mesh:
    """T triangles, corners unshared.

    Attributes:
        vertices: (T, 3, 3) positions.
        normals: (T, 3, 3) unit normals per corner.
        uvs: (T, 3, 2) texture coordinates, in the same unit of length as the positions.
    """

    vertices: Array
    normals: Array
    uvs: Array

    def placed(
        self, position: Triple = (0, 0, 0), rotation: NDArray[np.float64] | None = None
    ) -> "Mesh":
        """The mesh turned by a 3x3 rotation and then moved."""
        turn = np.eye(3) if rotation is None else rotation
        vertices = self.vertices @ turn.T + np.asarray(position)
        normals = self.normals @ turn.T
        return Mesh(vertices.astype(np.float32), normals.astype(np.float32), self.uvs)


def merged(meshes: Sequence[Mesh]) -> Mesh:
    """One soup out of several."""
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.normals for m in meshes]),
        np.concatenate([m.uvs for m in meshes]),
    )


def spin(angle: float, axis: int = 2) -> NDArray[np.float64]:
    """Rotation by an angle (radians) about a coordinate axis."""
    c, s = np.cos(angle), np.sin(angle)
    a, b = [(1, 2), (2, 0), (0, 1)][axis]
    rotation = np.eye(3)
    rotation[a, a] = rotation[b, b] = c
    rotation[a, b], rotation[b, a] = -s, s
    return rotation


def random_turn(rng: np.random.Generator) -> NDArray[np.float64]:
    """A uniformly random rotation."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    if np.linalg.det(q) < 0:
        q[:, 0] = -q[:, 0]
    return q


def surface(
    points: NDArray[np.float64], uv: NDArray[np.float64] | None = None, closed: bool = False
) -> Mesh:
    """Smooth surface over a grid of points.

    Args:
        points: (m, n, 3) grid; normals point along d/dn x d/dm ... of its two directions.
        uv: (m, n, 2) texture coordinates; None measures them along the grid's middle lines.
        closed: the last column is the first again (normals join there).
    """
    along = np.gradient(points, axis=0)
    across = np.gradient(points, axis=1)
    if closed:
        join = points[:, 1] - points[:, -2]
        across[:, 0] = across[:, -1] = join / 2
    normals = np.cross(across, along)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.where(length > 1e-12, normals / np.maximum(length, 1e-12), [0.0, 0.0, 1.0])
    if uv is None:
        uv = _measured(points)
    grid = np.concatenate([points, normals, uv], -1).astype(np.float32)
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    corners = np.stack([np.stack([a, b, c], 2), np.stack([a, c, d], 2)], 2).reshape(-1, 3, 8)
    edges = np.cross(corners[:, 1, :3] - corners[:, 0, :3], corners[:, 2, :3] - corners[:, 0, :3])
    corners = corners[np.einsum("ij,ij->i", edges, edges) > 1e-16]  # poles collapse triangles
    return Mesh(
        np.ascontiguousarray(corners[..., :3]),
        np.ascontiguousarray(corners[..., 3:6]),
        np.ascontiguousarray(corners[..., 6:]),
    )


def _measured(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Texture coordinates in lengths, measured along each grid direction's mean steps."""
    rows = np.linalg.norm(np.diff(points, axis=0), axis=-1).mean(1)
    columns = np.linalg.norm(np.diff(points, axis=1), axis=-1).max(0)
    v = np.concatenate([[0.0], np.cumsum(rows)])
    u = np.concatenate([[0.0], np.cumsum(columns)])
    return np.stack(np.meshgrid(u, v), -1)


def quad(origin: Triple, right: Triple, up: Triple) -> Mesh:
    """A flat parallelogram; its normal is right x up."""
    corner, u, v = (np.asarray(x, np.float64) for x in (origin, right, up))
    normal = np.cross(u, v)
    normal = normal / max(float(np.linalg.norm(normal)), 1e-12)
    width, height = float(np.linalg.norm(u)), float(np.linalg.norm(v))
    points = np.array([corner, corner + u, corner + u + v, corner + v], np.float32)
    uv = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    index = np.array([[0, 1, 2], [0, 2, 3]])
    normals = np.broadcast_to(normal.astype(np.float32), (2, 3, 3)).copy()
    return Mesh(points[index], normals, uv[index])


def box(size: Triple, centre: Triple = (0, 0, 0)) -> Mesh:
    """Axis-aligned box of a full size (x, y, z) about a centre."""
    half = np.asarray(size, np.float64) / 2
    faces = []
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        if axis == 1:  # texture v runs upwards on all upright faces
            a, b = b, a
        for side in (-1.0, 1.0):
            right, up, origin = np.zeros(3), np.zeros(3), -half.copy()
            right[a], up[b] = 2 * half[a], 2 * half[b]
            origin[axis] = side * half[axis]
            face = quad(origin, right, up)
            outward = np.zeros(3, np.float32)
            outward[axis] = side
            faces.append(Mesh(face.vertices, np.tile(outward, (2, 3, 1)), face.uvs))
    return merged(faces).placed(centre)


def lathe(profile: NDArray[np.float64], sides: int = 24) -> Mesh:
    """Surface of revolution about z.

    Args:
        profile: (n, 2) radius and height, from bottom to top (outside on the right).
        sides: facets around.
    """
    angle = np.linspace(0.0, 2 * np.pi, sides + 1)
    radius, height = profile[:, 0, None], profile[:, 1, None]
    points = np.stack(
        np.broadcast_arrays(radius * np.cos(angle), radius * np.sin(angle), height), -1
    )
    around = angle * max(float(profile[:, 0].max()), 1e-3)
    step = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1))])
    return surface(points, np.stack(np.meshgrid(around, step), -1), closed=True)


def cylinder(
    radius: float, height: float, top_radius: float | None = None, sides: int = 20
) -> Mesh:
    """Capped cylinder or cone on the plane z = 0; its edges stay sharp."""
    top = radius if top_radius is None else top_radius
    parts = [lathe(np.array([[radius, 0.0], [top, height]]), sides)]
    parts.append(lathe(np.array([[0.0, 0.0], [radius, 0.0]]), sides))
    if top > 0:
        parts.append(lathe(np.array([[top, height], [0.0, height]]), sides))
    return merged(parts)


def blob(
    radii: Triple,
    swell: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None,
    rings: int = 14,
    power: float = 1.0,
) -> Mesh:
    """Ellipsoid, superellipsoid (power != 1) or lump.

    Args:
        radii: half sizes along x, y, z.
        swell: factor on the radius for (..., 3) unit directions.
        rings: facets from pole to pole.
        power: exponent of the angle functions; below 1 squarer, above 1 pinched.
    """
    polar = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)[:, None]
    angle = np.linspace(0.0, 2 * np.pi, 2 * rings + 1)[None]
    angle = np.where(np.arange(2 * rings + 1) == 2 * rings, 0.0, angle)

    def bent(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.sign(x) * np.abs(x) ** power

    unit = np.stack(
        np.broadcast_arrays(
            bent(np.cos(polar)) * bent(np.cos(angle)),
            bent(np.cos(polar)) * bent(np.sin(angle)),
            bent(np.sin(polar)),
        ),
        -1,
    )
    unit[0], unit[-1] = [0, 0, -1], [0, 0, 1]
    points = unit * np.asarray(radii, np.float64)
    if swell is not None:
        points = points * swell(unit)[..., None]
    mesh = surface(points, closed=True)
    return mesh


def tube(path: NDArray[np.float64], radius: NDArray[np.float64] | float, sides: int = 8) -> Mesh:
    """A round tube along a path (n, 3), with a radius per path point."""
    ahead = np.gradient(path, axis=0)
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    guide = np.array([0.0, 0.0, 1.0]) if abs(ahead[0, 2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    side = np.cross(ahead, guide)
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    up = np.cross(side, ahead)
    angle = np.linspace(0.0, 2 * np.pi, sides + 1)[None, :, None]
    r = np.broadcast_to(np.asarray(radius, np.float64), len(path))[:, None, None]
    points = path[:, None] + r * (np.cos(angle) * side[:, None] + np.sin(angle) * up[:, None])
    return surface(points, closed=True)


def torus(major: float, minor: float, sides: int = 24) -> Mesh:
    """A ring about z."""
    angle = np.linspace(0.0, 2 * np.pi, sides + 1)
    path = np.stack([major * np.cos(angle), major * np.sin(angle), 0 * angle], 1)
    ring = np.linspace(0.0, 2 * np.pi, sides // 2 + 1)
    out = path / major
    points = path[:, None] + minor * (
        np.cos(ring)[None, :, None] * out[:, None]
        + np.sin(ring)[None, :, None] * np.array([0.0, 0.0, 1.0])
    )
    return surface(points, closed=True)
