"""A wavy wall seen by cameras that are known exactly: what a perfect network would give."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.matches import Matches, as_pictures, match_views
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.pipeline import Scene

SIDE, FOCAL, DEPTH, WAVE = 192, 200.0, 2.0, 0.3
MEETINGS = 60  # of a ray with the wall: each halves what is left of the error, and more


def poses(count: int) -> list[NDArray[np.float64]]:
    """World-to-camera of cameras that step aside and turn towards the wall; the first is at 0."""
    found = []
    for index in range(count):
        turn = cv2.Rodrigues(np.array([0.02 * index, 0.14 * index, 0.05 * index]))[0]
        pose = np.eye(4)
        pose[:3, :3] = turn
        pose[:3, 3] = -turn @ np.array([0.3 * index, -0.05 * index, 0.04 * index])
        found.append(pose)
    return found


def wall(count: int, seed: int = 0) -> tuple[Scene, Recovered]:
    """The scene of so many views and its cameras, all of them right."""
    texture = _texture(seed)
    images, means, cameras = [], [], []
    for pose in poses(count):
        points = _meet(pose)
        place = ((points[..., :2] / 6 + 0.5) * len(texture)).astype(np.float32)
        colours = cv2.remap(texture, place[..., 0], place[..., 1], cv2.INTER_CUBIC)
        images.append(colours.clip(0, 1).transpose(2, 0, 1))
        means.append(points)
        cameras.append(Camera(pose, FOCAL, FOCAL, SIDE / 2, SIDE / 2, SIDE, SIDE))
    shape = (count, SIDE, SIDE)
    lens = np.array([[FOCAL / SIDE, 0, 0.5], [0, FOCAL / SIDE, 0.5], [0, 0, 1]], np.float32)
    scene = Scene(
        images=np.array(images, np.float32),
        intrinsics=np.tile(lens, (count, 1, 1)),
        means=np.array(means, np.float32),
        scales=np.full((*shape, 3), DEPTH / FOCAL, np.float32),
        rotations=np.tile(np.array([1, 0, 0, 0], np.float32), (*shape, 1)),
        opacities=np.full(shape, 0.9, np.float32),
        content_tokens=np.zeros((count, 4, 8), np.float32),
    )
    return scene, Recovered(cameras, [1.0] * count, [True] * count, FOCAL, FOCAL, [])


def match_images(images: NDArray[np.float32], threads: int | None = None) -> list[Matches]:
    """Matches of views (N, 3, H, W), looked for in these pictures themselves."""
    return match_views(as_pictures(images), images.shape[2:], threads)


def _texture(seed: int) -> NDArray[np.float32]:
    """Blobs of all sizes, which SIFT likes."""
    random = np.random.default_rng(seed)
    picture = np.zeros((1024, 1024, 3))
    for side in (64, 128, 256, 512):
        noise = random.uniform(-0.5, 0.5, (side, side, 3))
        picture += 0.4 * cv2.resize(noise, (1024, 1024), interpolation=cv2.INTER_CUBIC)
    return (picture + 0.5).astype(np.float32)


def _meet(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """(H, W, 3) where a camera's rays meet the wall, by fixed-point iteration."""
    grid = (np.arange(SIDE) + 0.5 - SIDE / 2) / FOCAL
    x, y = np.meshgrid(grid, grid)
    rays = np.stack([x, y, np.ones_like(x)], -1) @ pose[:3, :3]
    eye = -pose[:3, :3].T @ pose[:3, 3]
    points = eye + rays * ((DEPTH - eye[2]) / rays[..., 2])[..., None]
    for _ in range(MEETINGS):
        depth = DEPTH + WAVE * np.sin(1.5 * points[..., 0]) * np.cos(1.2 * points[..., 1])
        points = eye + rays * ((depth - eye[2]) / rays[..., 2])[..., None]
    return points
