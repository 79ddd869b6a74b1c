"""A scene of any size drawn in float64: splat by splat, each on the pixels that it reaches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera

Array = NDArray[np.float64]


def rotations_of(quaternions: Array) -> Array:
    """(G, 3, 3) of quaternions w x y z."""
    w, v = quaternions[:, 0], quaternions[:, 1:]
    length = np.linalg.norm(quaternions, axis=1)
    w, v = w / length, v / length[:, None]
    cross = np.zeros((len(w), 3, 3))
    cross[:, [2, 0, 1], [1, 2, 0]], cross[:, [1, 2, 0], [2, 0, 1]] = v, -v
    return np.eye(3) + 2 * w[:, None, None] * cross + 2 * cross @ cross


def draw_in_float64(scene: dict[str, Array], camera: Camera, near: float) -> Array:
    """(H, W, 3) over black of means, scales, rotations, opacities and colours, all float64."""
    in_view = scene["means"] @ camera.extrinsics[:3, :3].T + camera.extrinsics[:3, 3]
    x, y, z = in_view.T
    shown = np.flatnonzero((z > near) & (scene["opacities"] > 1 / 255))
    width, height, fx, fy = camera.width, camera.height, camera.fx, camera.fy
    slope_x = np.clip(x / z, (-camera.cx - 0.15 * width) / fx, (1.15 * width - camera.cx) / fx)
    slope_y = np.clip(y / z, (-camera.cy - 0.15 * height) / fy, (1.15 * height - camera.cy) / fy)
    jacobian = np.zeros((len(z), 2, 3))
    jacobian[:, 0, 0], jacobian[:, 0, 2] = fx / z, -fx / z * slope_x
    jacobian[:, 1, 1], jacobian[:, 1, 2] = fy / z, -fy / z * slope_y
    turns = camera.extrinsics[:3, :3] @ rotations_of(scene["rotations"])
    rows = jacobian @ (turns * scene["scales"][:, None, :])
    covariances = rows @ rows.transpose(0, 2, 1) + 0.3 * np.eye(2)
    inverses = np.linalg.inv(covariances)
    centres = np.stack([fx * x / z + camera.cx, fy * y / z + camera.cy], -1)
    colour, transmittance = np.zeros((height, width, 3)), np.ones((height, width))
    done = np.zeros((height, width), bool)
    for i in shown[np.argsort(z[shown].astype(np.float32), kind="stable")]:
        reach = 2 * np.log(255 * scene["opacities"][i])
        radius = np.sqrt(reach * np.diag(covariances[i])) + 1
        low = np.maximum(np.floor(centres[i] - radius), 0)
        high = np.minimum(np.ceil(centres[i] + radius), [width, height])
        if (low >= high).any():
            continue
        (x0, y0), (x1, y1) = low.astype(int), high.astype(int)
        dx = np.arange(x0, x1) + 0.5 - centres[i, 0]
        dy = np.arange(y0, y1)[:, None] + 0.5 - centres[i, 1]
        (a, b), (_, c) = inverses[i]
        alpha = scene["opacities"][i] * np.exp(-0.5 * (a * dx**2 + 2 * b * dx * dy + c * dy**2))
        alpha = np.minimum(0.99, alpha)
        here = np.s_[y0:y1, x0:x1]
        seen = (alpha >= 1 / 255) & ~done[here]
        after = transmittance[here] * (1 - alpha)
        done[here] |= seen & (after < 1e-4)
        drawn = seen & ~done[here]
        weight = np.where(drawn, alpha * transmittance[here], 0)
        colour[here] += weight[..., None] * np.maximum(scene["colours"][i], 0)
        transmittance[here] = np.where(drawn, after, transmittance[here])
    return colour
