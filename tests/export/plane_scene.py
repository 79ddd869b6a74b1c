"""A textured plane seen from three places: what a perfect model would say of it is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.pipeline import Scene
from styl3r_export.evaluate.align import Similarity
from styl3r_export.evaluate.groups import Group
from styl3r_export.evaluate.predict import Prediction
from styl3r_export.evaluate.scenes import TrueScene, TrueView

NORMAL, DISTANCE = np.array([0.3, -0.2, -1.0]), -4.0  # NORMAL . x = DISTANCE, about 4 units off

Array = NDArray[np.float64]


def cameras(side: int) -> list[Camera]:
    """Three steps to the right, turning back towards the middle."""
    found = []
    for step in (0.0, 0.5, 1.0):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_rotvec([0.02 * step, -0.12 * step, 0.03 * step]).as_matrix()
        pose[:3, 3] = -pose[:3, :3] @ [0.6 * step, 0.05 * step, 0.0]
        found.append(Camera(pose, 1.1 * side, 1.1 * side, side / 2 + 1, side / 2, side, side))
    return found


def surface(camera: Camera) -> Array:
    """(H, W, 3): where the pixels' rays meet the plane, world."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], -1)
    rotation, eye = camera.extrinsics[:3, :3], np.linalg.inv(camera.extrinsics)[:3, 3]
    world = rays @ rotation
    return eye + world * ((DISTANCE - NORMAL @ eye) / (world @ NORMAL))[..., None]


def texture(points: Array) -> Array:
    """Smooth colours of points on the plane, in [0, 1]."""
    x, y = points[..., 0], points[..., 1]
    waves = [np.sin(5 * x + 2 * y), np.cos(4 * y - 3 * x), np.sin(7 * x) * np.cos(6 * y)]
    return 0.5 + 0.4 * np.stack(waves, axis=-1)


def plane_group(side: int) -> Group:
    """The outer two given, the middle one to be drawn; 400 points known."""
    spots = np.random.default_rng(0).integers(0, side, (400, 2))
    world = surface(cameras(side)[1])[spots[:, 1], spots[:, 0]]
    views = []
    for index, camera in enumerate(cameras(side)):
        pixels = np.rint(texture(surface(camera)) * 255).astype(np.uint8)
        local = world @ camera.extrinsics[:3, :3].T + camera.extrinsics[:3, 3]
        uv = local @ camera.intrinsics.T
        uv = uv[:, :2] / uv[:, 2:]
        seen = np.flatnonzero(((uv > 0) & (uv < side)).all(axis=1))
        views.append(
            TrueView(f"{index}.png", pixels, camera, seen, uv[seen], local[seen, 2], (side, side))
        )
    return Group(TrueScene("plane", views), (0, 2), (1,))


def perfect_prediction(group: Group, world: Similarity) -> tuple[Prediction, Gaussians]:
    """What a model that sees everything right says, in a world of its own."""
    true = [view.camera for view in group.views]
    found = [world.camera(camera) for camera in true]
    points = np.stack([surface(camera) for camera in true])
    means = (world.scale * points @ world.rotation.T + world.shift).astype(np.float32)
    shape = means.shape[:3]
    images = np.stack([view.image for view in group.views])
    scales = np.full_like(means, world.scale * 4 / (1.1 * shape[1]) * 0.5)
    rotations = np.zeros((*shape, 4), np.float32)
    rotations[..., 0] = 1
    opacities = np.full(shape, 0.9, np.float32)
    lens = np.stack([c.intrinsics / np.array([[c.width], [c.height], [1.0]]) for c in true])
    tokens = np.zeros((shape[0], 1, 1), np.float32)
    scene = Scene(images, lens.astype(np.float32), means, scales, rotations, opacities, tokens)
    recovered = Recovered(found, [1.0] * 2, [True] * 2, true[0].fx, true[0].fx, [])
    given = [replace(camera, extrinsics=np.eye(4)) for camera in true]
    colours = images.transpose(0, 2, 3, 1).reshape(-1, 3)
    flat = [a.reshape(-1, a.shape[-1]) for a in (means, scales, rotations)]
    gaussians = Gaussians(*flat, opacities.ravel(), colours)
    return Prediction(scene, recovered, given), gaussians
