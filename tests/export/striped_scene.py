"""A striped world that the tiny model sees exactly, as a scene folder in the stored layout."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation
from tiny_model import BASELINE

SIDE, FOCAL, UNIT, PHOTOS = 64, 70.0, 3.0, 5


def row_depth(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """What the tiny model says of `photo` at these rows: 2 + brightness, the same along x."""
    return 2 + photo()[rows.astype(int), 0].mean(axis=-1) / 255


def photo() -> NDArray[np.float64]:
    """(SIDE, SIDE, 3): grey stripes, so that cameras side by side see the same."""
    grey = 128 + 100 * np.sin(np.arange(SIDE) / 9)
    return np.rint(np.broadcast_to(grey[:, None, None], (SIDE, SIDE, 3)))


def write_scene(folder: Path, photos: int = PHOTOS) -> Path:
    """A scene in the stored layout: the world that the tiny model sees, in other units."""
    (folder / "images").mkdir(parents=True)
    rng = np.random.default_rng(0)
    pixels = rng.uniform([-SIDE, 1], [2 * SIDE, SIDE - 1], (900, 2))
    depth = row_depth(pixels[:, 1])
    rays = np.column_stack([(pixels - SIDE / 2) / FOCAL, np.ones(len(pixels))])
    points = rays * depth[:, None]
    # Any frame of the world will do; the evaluation must not depend on it.
    turn, shift = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix(), np.array([1.0, -2.0, 0.5])
    world, images, observations = (points @ turn.T + shift) * UNIT, {}, []
    for k in range(photos):
        name = f"{k:03d}.png"
        Image.fromarray(photo().astype(np.uint8)).save(folder / "images" / name)
        w2c = np.eye(4)
        w2c[:3, :3] = turn.T
        w2c[:3, 3] = -UNIT * (turn.T @ shift + [BASELINE * k, 0, 0])
        seen = points - [BASELINE * k, 0, 0]
        uv = FOCAL * seen[:, :2] / seen[:, 2:] + SIDE / 2
        inside = np.flatnonzero(((uv > 0) & (uv < SIDE)).all(axis=1))
        observations += [(k, point, *uv[point]) for point in inside]
        lens = {"fx": FOCAL, "fy": FOCAL, "cx": SIDE / 2, "cy": SIDE / 2}
        images[name] = lens | {"width": SIDE, "height": SIDE, "w2c": w2c.tolist()}
    table = np.array(observations)
    np.savez(
        folder / "points.npz",
        xyz=world.astype(np.float32),
        image_names=np.array(list(images)),
        obs_image=table[:, 0].astype(np.int64),
        obs_point=table[:, 1].astype(np.int64),
        obs_uv=table[:, 2:].astype(np.float32),
    )
    (folder / "cameras.json").write_text(json.dumps({"images": images}))
    return folder
