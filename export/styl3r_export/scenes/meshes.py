"""Triangle soups: the type, flat quads and boxes, smooth surfaces over grids of points."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.splatting.compiler import kernel

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


@kernel
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


@kernel
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


@kernel
def _sheet_triangles(points: NDArray[np.float64], uv: NDArray[np.float64]) -> NDArray[np.float32]:
    """(T, 3, 8) corners of k separate grids (k, m, n, 3)."""
    sheets, rows, columns = points.shape[:3]
    cells = 2 * (rows - 1) * (columns - 1)
    corners = np.empty((sheets * cells, 3, 8), np.float32)
    grid = np.empty((rows, columns, 8), np.float32)
    count = 0
    for k in range(sheets):
        grid[..., :3], grid[..., 6:] = points[k], uv[k]
        grid[..., 3:6] = _grid_normals(points[k], False)
        made = _grid_triangles(grid)
        corners[count : count + len(made)] = made
        count += len(made)
    return corners[:count]


def sheets(points: NDArray[np.float64], uv: NDArray[np.float64]) -> Mesh:
    """Many open surfaces of one resolution at once: leaves, petals, blades.

    Args:
        points: (k, m, n, 3) grids.
        uv: (k, m, n, 2) texture coordinates.
    """
    corners = _sheet_triangles(np.ascontiguousarray(points), np.ascontiguousarray(uv))
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
    scaled = np.asarray(unit * (np.asarray(size, np.float32) / 2), np.float32)
    uvs = np.take_along_axis(scaled, axes, 2)
    return Mesh(scaled + np.asarray(centre, np.float32), normals, uvs)
