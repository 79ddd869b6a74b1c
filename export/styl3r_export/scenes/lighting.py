"""Shadow maps and the occupancy grid that darkens corners and contacts."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.builder import Light, Scene
from styl3r_export.scenes.visibility import first_hits, to_camera

#: Side of a shadow map in texels.
SHADOW_SIDE = 384
#: Cells per axis of the occupancy grid.
GRID = 40
#: Points strewn over the surfaces to fill the grid: about 20 per occupied cell.
GRID_POINTS = 60_000
#: Blur of the occupancy in cells; also how far above a surface it is read.
GRID_BLUR = 1.3


@dataclass(frozen=True)
class LightMaps:
    """What shading needs to know of the lights, as arrays.

    Attributes:
        places: (L, 3) where the lights stand.
        extrinsics: (L, 4, 4) world to light camera.
        focal: (L,) of the light cameras, texels.
        colours: (L, 3) linear.
        kinds: (L, 2) whether it falls off, and the softness in texels.
        maps: (L, S, S) inverse depth seen from the light.
        occupancy: (G, G, G) how crowded the space is; 1 is on a lone surface.
        grid_low: (3,) corner of the grid.
        grid_cell: size of a cell.
    """

    places: NDArray[np.float32]
    extrinsics: NDArray[np.float32]
    focal: NDArray[np.float32]
    colours: NDArray[np.float32]
    kinds: NDArray[np.float32]
    maps: NDArray[np.float32]
    occupancy: NDArray[np.float32]
    grid_low: NDArray[np.float32]
    grid_cell: float


def look_at(
    eye: NDArray[np.float64], target: NDArray[np.float64], roll: float = 0.0
) -> NDArray[np.float64]:
    """World-to-camera 4x4 (x right, y down, z forward) in a world whose z is up."""
    forward = np.asarray(target, np.float64) - eye
    forward = forward / np.linalg.norm(forward)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.999 else np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    rotation = np.stack([c * right + s * down, c * down - s * right, forward])
    extrinsics = np.eye(4)
    extrinsics[:3, :3], extrinsics[:3, 3] = rotation, -rotation @ eye
    return extrinsics


def light_maps(scene: Scene, low: NDArray[np.float64], high: NDArray[np.float64]) -> LightMaps:
    """Cast the lights' rays and fill the occupancy grid over the box low..high."""
    casts = np.array([m.casts and not m.glow for m in scene.materials])
    solid = scene.vertices[casts[scene.parts]]
    side = SHADOW_SIDE
    maps = np.zeros((len(scene.lights), side, side), np.float32)
    hits = np.empty((side, side), np.int32)
    focal, extrinsics = [], []
    for k, light in enumerate(scene.lights):
        extrinsics.append(look_at(light.position, light.target))
        focal.append(side / 2 / np.tan(light.spread / 2))
        lens = (focal[-1], focal[-1], side / 2, side / 2)
        first_hits(to_camera(solid, extrinsics[-1]), lens, maps[k], hits)
    matter = np.array([not m.glow for m in scene.materials])
    cell = float((high - low).max()) / (GRID - 4)
    corner = (low + high) / 2 - cell * GRID / 2
    return LightMaps(
        np.array([light.position for light in scene.lights], np.float32).reshape(-1, 3),
        np.array(extrinsics, np.float32).reshape(-1, 4, 4),
        np.array(focal, np.float32),
        np.array([light.colour for light in scene.lights], np.float32).reshape(-1, 3),
        np.array([_kind(x) for x in scene.lights], np.float32).reshape(-1, 2),
        maps,
        _occupancy(scene.vertices[matter[scene.parts]], corner, cell),
        corner.astype(np.float32),
        cell,
    )


def _kind(light: Light) -> tuple[float, float]:
    return float(light.falls_off), light.softness


def _occupancy(
    triangles: NDArray[np.float32], corner: NDArray[np.float64], cell: float
) -> NDArray[np.float32]:
    """Blurred surface density in a grid; deterministic points, so no random source."""
    far = corner + GRID * cell
    inside = (triangles.min(1) < far).all(1) & (triangles.max(1) > corner).all(1)
    triangles = triangles[inside]
    grid = np.zeros(GRID**3, np.float32)
    if not len(triangles):
        return grid.reshape(GRID, GRID, GRID)
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1).astype(np.float64) / 2
    steps = (np.arange(GRID_POINTS) + 0.5) / GRID_POINTS * areas.sum()
    owner = np.minimum(np.searchsorted(np.cumsum(areas), steps), len(areas) - 1)
    # The plastic-number sequence covers each triangle evenly without a random source.
    s = (np.arange(GRID_POINTS) * 0.7548776662466927) % 1
    t = (np.arange(GRID_POINTS) * 0.5698402909980532) % 1
    s, t = np.where(s + t > 1, 1 - s, s), np.where(s + t > 1, 1 - t, t)
    u = (1 - s - t)[:, None]
    points = u * a[owner] + s[:, None] * b[owner] + t[:, None] * c[owner]
    index = np.floor((points - corner) / cell).astype(np.int64)
    index = index[((index >= 0) & (index < GRID)).all(1)]
    flat = (index[:, 0] * GRID + index[:, 1]) * GRID + index[:, 2]
    per_cell = GRID_POINTS * cell * cell / areas.sum()
    grid = np.bincount(flat, minlength=GRID**3).astype(np.float32) / per_cell
    grid = np.minimum(grid, 3.0).reshape(GRID, GRID, GRID)
    for _ in range(3):  # blur along the last axis, then bring the next one there
        rows = grid.reshape(GRID * GRID, GRID)
        rows = cv2.GaussianBlur(rows, (9, 1), GRID_BLUR, borderType=cv2.BORDER_REPLICATE)
        grid = np.ascontiguousarray(rows.reshape(GRID, GRID, GRID).transpose(2, 0, 1))
    return grid
