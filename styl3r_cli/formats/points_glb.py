"""glTF (.points.glb) for programs that know no Gaussians: coloured points and camera frusta.

Written by trimesh. Axes are those of the .glb with Gaussians: y up, z towards whoever looks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from styl3r_cli import limits, needs
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.stored import cameras_from_metadata
from styl3r_cli.errors import InputError
from styl3r_cli.formats.glb_container import Arrays
from styl3r_cli.formats.scene import Encoded, Scene
from styl3r_cli.formats.values import finite_only, turned
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.srgb import to_linear

if TYPE_CHECKING:
    from trimesh.path import Path3D

# Points are opaque, so what is more transparent than this would stand out more than it should.
LEAST_OPACITY = 0.1
FRUSTUM_DEPTH = 0.05  # of the scene's diagonal: to be seen beside it without covering it
CENTRAL = (5, 95)  # percentiles between which the diagonal is measured; a few points are far out
FRUSTUM_COLOUR = (255, 140, 0, 255)  # orange is rare in rooms and streets
EMPTY = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{}]}
# From the camera's centre (4) to the corners of its picture (0 to 3), and round them.
FRUSTUM_LINE = (0, 1, 2, 3, 0, 4, 1, 2, 4, 3)


def encode(gaussians: Gaussians, metadata: dict[str, str]) -> Encoded:
    """One point a Gaussian, in linear colours as glTF has them, and a frustum a view.

    Args:
        gaussians: the scene; nearly transparent Gaussians are left out.
        metadata: its cameras become frusta, the rest is left out.
    """
    limits.check(needs.points())  # under less, the scipy that it brings waits for ever
    import trimesh

    notes: list[str] = []
    scene = finite_only(gaussians, notes)
    kept = turned(scene.gaussians.select(scene.gaussians.opacities >= LEAST_OPACITY))
    notes.append(
        f".points.glb keeps points of {len(kept)} of {len(scene.gaussians)} Gaussians (opacity at "
        f"least {LEAST_OPACITY:g}): no scales, rotations or opacities; it cannot be read back"
    )
    picture = trimesh.Scene()
    if len(kept):
        colours = np.full((len(kept), 4), 255, np.uint8)
        colours[:, :3] = np.rint(to_linear(kept.colours) * 255)
        cloud = trimesh.PointCloud(kept.means, colors=colours)
        picture.add_geometry(cloud, node_name="points", geom_name="points")
    cameras = cameras_from_metadata(metadata)
    size = frustum_depth(kept.means)
    for index, camera in enumerate(cameras):
        name = f"view {index + 1}"
        picture.add_geometry(_frustum(camera, size), node_name=name, geom_name=name)
    if cameras:
        notes.append(f"{len(cameras)} cameras are drawn as frusta {size:.3g} deep")
    # trimesh refuses to write a scene of nothing.
    data = picture.export(file_type="glb") if picture.geometry else Arrays().bundle(EMPTY)
    return Encoded(bytes(data), len(kept), scene.dropped, notes)


def decode(data: bytes, name: str) -> Scene:
    """Points have no scales: there is no scene in such a file.

    Raises:
        InputError: always, unless the file holds Gaussians after all.
    """
    from styl3r_cli.formats import glb

    try:
        return glb.decode(data, name)
    except InputError as error:
        if "without Gaussians" not in str(error):
            raise
        raise InputError(f"{name}: points and frusta for looking at; not a scene") from error


def frustum_depth(means: NDArray[np.float32]) -> float:
    """How far from the centre a frustum's picture is drawn, in scene units."""
    if not len(means):
        return 1.0
    low, high = np.percentile(means, CENTRAL, axis=0)
    return FRUSTUM_DEPTH * float(np.linalg.norm(high - low)) or 1.0


def frustum_corners(camera: Camera, depth: float) -> NDArray[np.float64]:
    """(5, 3) world: the picture's corners, clockwise from the top left, and the centre."""
    x = (np.array([0, camera.width, camera.width, 0]) - camera.cx) / camera.fx
    y = (np.array([0, 0, camera.height, camera.height]) - camera.cy) / camera.fy
    local = np.vstack([np.column_stack([x, y, np.ones(4)]) * depth, np.zeros(3)])
    turn, offset = camera.extrinsics[:3, :3], camera.extrinsics[:3, 3]
    return (local - offset) @ turn  # turn^T (local - offset), for rows


def _frustum(camera: Camera, depth: float) -> Path3D:
    from trimesh.path import Path3D
    from trimesh.path.entities import Line

    corners = frustum_corners(camera, depth) * [1, -1, -1]
    colours = np.array([FRUSTUM_COLOUR], np.uint8)
    return Path3D([Line(FRUSTUM_LINE)], corners, process=False, colors=colours)
