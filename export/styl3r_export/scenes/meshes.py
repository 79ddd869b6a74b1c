"""Triangle soups: boxes, surfaces over a grid, lathes, tubes and blobs."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float32]
#: Three numbers, or any array of them.
Triple = Sequence[float] | NDArray[np.floating]
#: The two triangles of a quadrilateral.
QUAD = np.array([[0, 1, 2], [0, 2, 3]])
#: Squared parallelogram area below which a triangle has collapsed, as at poles.
COLLAPSED = 1e-16


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
        offset = np.asarray(position, np.float32)
        if rotation is None:
            return Mesh(self.vertices + offset, self.normals, self.uvs)
        turn = rotation.T.astype(np.float32)
        vertices = self.vertices.reshape(-1, 3) @ turn + offset
        normals = self.normals.reshape(-1, 3) @ turn
        return Mesh(vertices.reshape(-1, 3, 3), normals.reshape(-1, 3, 3), self.uvs)


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


@njit(cache=True, nogil=True)
def _grid_normals(points: NDArray[np.float64], closed: bool) -> NDArray[np.float64]:
    """(m, n, 3) unit normals of a grid of points from its central differences."""
    rows, columns = points.shape[:2]
    normals = np.empty((rows, columns, 3))
    for i in range(rows):
        for j in range(columns):
            low, high = max(j - 1, 0), min(j + 1, columns - 1)
            if closed and (j == 0 or j == columns - 1):
                low, high = columns - 2, 1
            a = points[i, high] - points[i, low]
            b = points[min(i + 1, rows - 1), j] - points[max(i - 1, 0), j]
            x, y = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2]
            z = a[0] * b[1] - a[1] * b[0]
            length = np.sqrt(x * x + y * y + z * z)
            if length < 1e-14:  # a pole: its neighbours' directions cancel
                x, y, z, length = 0.0, 0.0, 1.0, 1.0
            normals[i, j, 0], normals[i, j, 1] = x / length, y / length
            normals[i, j, 2] = z / length
    return normals


@njit(cache=True, nogil=True)
def _grid_triangles(grid: NDArray[np.float32]) -> NDArray[np.float32]:
    """(T, 3, C) corners of the two triangles of every cell, collapsed ones left out."""
    rows, columns, channels = grid.shape
    corners = np.empty((2 * (rows - 1) * (columns - 1), 3, channels), np.float32)
    count = 0
    for i in range(rows - 1):
        for j in range(columns - 1):
            for half in range(2):
                a, c = grid[i, j], grid[i + 1, j + 1]
                b = grid[i, j + 1] if half else grid[i + 1, j]
                area = 0.0
                for k in range(3):
                    m, n = (k + 1) % 3, (k + 2) % 3
                    part = (b[m] - a[m]) * (c[n] - a[n]) - (b[n] - a[n]) * (c[m] - a[m])
                    area += part * part
                if area > COLLAPSED:
                    corners[count, 0], corners[count, 1], corners[count, 2] = a, b, c
                    count += 1
    return corners[:count]


def surface(
    points: NDArray[np.float64], uv: NDArray[np.float64] | None = None, closed: bool = False
) -> Mesh:
    """Smooth surface over a grid of points.

    Args:
        points: (m, n, 3) grid.
        uv: (m, n, 2) texture coordinates; None measures them along the grid's middle lines.
        closed: the last column is the first again (normals join there).
    """
    points = np.ascontiguousarray(points, np.float64)
    normals = _grid_normals(points, closed)
    if uv is None:
        uv = _measured(points)
    corners = _grid_triangles(np.concatenate([points, normals, uv], -1).astype(np.float32))
    return Mesh(corners[..., :3], corners[..., 3:6], corners[..., 6:])


def _measured(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Texture coordinates in lengths, measured along the grid's middle row and column."""
    rows, columns = points.shape[:2]
    down = np.diff(points[:, columns // 2], axis=0)
    across = np.diff(points[rows // 2], axis=0)
    uv = np.zeros((rows, columns, 2))
    uv[:, 1:, 0] = np.cumsum(np.sqrt((across * across).sum(1)))
    uv[1:, :, 1] = np.cumsum(np.sqrt((down * down).sum(1)))[:, None]
    return uv


def quad(origin: Triple, right: Triple, up: Triple) -> Mesh:
    """A flat parallelogram; its normal is right x up."""
    corner, u, v = (np.asarray(x, np.float64) for x in (origin, right, up))
    normal = np.array(
        [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    )
    normal /= max(math.sqrt(normal @ normal), 1e-12)
    width, height = math.sqrt(u @ u), math.sqrt(v @ v)
    points = np.array([corner, corner + u, corner + u + v, corner + v], np.float32)
    uv = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    normals = np.empty((2, 3, 3), np.float32)
    normals[:] = normal
    return Mesh(points[QUAD], normals, uv[QUAD])


def _unit_box() -> tuple[Array, Array, NDArray[np.intp]]:
    """Corners and normals of a box of half size 1, and the axes of each face's texture."""
    vertices, normals, axes = [], [], []
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        if axis == 1:  # texture v runs upwards on all upright faces
            a, b = b, a
        for side in (-1.0, 1.0):
            right, up, origin, outward = np.zeros(3), np.zeros(3), -np.ones(3), np.zeros(3)
            right[a] = up[b] = 2.0
            origin[axis] = outward[axis] = side
            vertices.append(quad(origin, right, up).vertices)
            normals.append(np.tile(outward, (2, 3, 1)))
            axes.append(np.tile([a, b], (2, 3, 1)))
    return (
        np.concatenate(vertices),
        np.concatenate(normals).astype(np.float32),
        np.concatenate(axes),
    )


UNIT_BOX = _unit_box()


def box(size: Triple, centre: Triple = (0, 0, 0)) -> Mesh:
    """Axis-aligned box of a full size (x, y, z) about a centre."""
    unit, normals, axes = UNIT_BOX
    scaled = unit * (np.asarray(size, np.float32) / 2)
    uvs = np.take_along_axis(scaled, axes, 2)
    return Mesh(scaled + np.asarray(centre, np.float32), normals, uvs)


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
    return surface(points, closed=True)


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
