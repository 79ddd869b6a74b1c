"""A small scene as networks make them: a picture's pixels from two views, on one surface."""

from __future__ import annotations

import numpy as np

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import Gaussians

SIDE, FOCAL, DEPTH = 64, 64.0, 2.0
STRIPED_UP_TO = -0.5


def views() -> list[Camera]:
    """Two cameras beside each other, looking along z."""
    cameras = []
    for x in (0.0, 0.12):
        extrinsics = np.eye(4)
        extrinsics[0, 3] = -x
        cameras.append(Camera(extrinsics, FOCAL, FOCAL, SIDE / 2, SIDE / 2, SIDE, SIDE))
    return cameras


def layered_scene(seed: int = 0) -> Gaussians:
    """One Gaussian a pixel of both views: most of the wall is flat, the top striped."""
    random = np.random.default_rng(seed)
    sheets = []
    for layer, camera in enumerate(views()):
        y, x = (np.mgrid[:SIDE, :SIDE] + 0.5 - SIDE / 2) * DEPTH / FOCAL
        z = np.full_like(x, DEPTH + 0.01 * layer)
        sheets.append(np.stack([x - camera.extrinsics[0, 3], y, z], -1).reshape(-1, 3))
    means = np.concatenate(sheets)
    stripes = 0.5 + 0.5 * np.sign(np.sin(12 * means[:, 0]))
    flat = means[:, 1] > STRIPED_UP_TO
    value = np.where(flat, 0.6, stripes)
    colours = value[:, None] * np.array([1.0, 0.8, 0.3]) + random.uniform(0, 0.004, means.shape)
    count = len(means)
    return Gaussians(
        means,
        np.full((count, 3), 0.5 * DEPTH / FOCAL),
        np.tile([1.0, 0, 0, 0], (count, 1)),
        np.full(count, 0.95),
        colours,
    )


def joined(*parts: Gaussians) -> Gaussians:
    """Scenes as one."""
    names = ("means", "scales", "rotations", "opacities", "colours")
    return Gaussians(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
