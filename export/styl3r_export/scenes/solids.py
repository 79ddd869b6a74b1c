"""Round and turned bodies: lathes, cylinders, blobs, tubes, rings."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.meshes import Mesh, Triple, merged, surface


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


def disc(radius: float, height: float, sides: int = 20) -> Mesh:
    """A level disc with its texture laid flat on it."""
    angle = np.linspace(0.0, 2 * np.pi, sides + 1)
    rim = radius * np.stack([np.cos(angle), np.sin(angle)], 1)
    points = np.zeros((2, sides + 1, 3))
    points[1, :, :2], points[..., 2] = rim, height
    return surface(points, points[..., :2].copy())


def cylinder(
    radius: float, height: float, top_radius: float | None = None, sides: int = 20
) -> Mesh:
    """Capped cylinder or cone on the plane z = 0; its edges stay sharp."""
    top = radius if top_radius is None else top_radius
    parts = [lathe(np.array([[radius, 0.0], [top, height]]), sides), disc(radius, 0.0, sides)]
    if top > 0:
        parts.append(disc(top, height, sides))
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
