"""The splatting formula written out in float64 numpy, every pixel against every Gaussian."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import Gaussians

# How near to a threshold (relative) a float32 renderer may decide the other way.
BAND = 1e-4


@dataclass(frozen=True)
class Expected:
    """The formula's picture, and the pixels where a threshold is too close to call."""

    colour: NDArray[np.float64]
    alpha: NDArray[np.float64]
    depth: NDArray[np.float64]
    median_depth: NDArray[np.float64]
    borderline: NDArray[np.bool_]
    median_borderline: NDArray[np.bool_]


def rotation_matrix(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """By Rodrigues' formula, from the axis and angle of a quaternion w x y z."""
    q = quaternion / np.linalg.norm(quaternion)
    axis_length = np.linalg.norm(q[1:])
    if axis_length == 0:
        return np.eye(3)
    axis, angle = q[1:] / axis_length, 2 * np.arctan2(axis_length, q[0])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def frame_covariance(
    in_view: NDArray[np.float64], world_covariance: NDArray[np.float64], camera: Camera
) -> NDArray[np.float64]:
    """EWA's covariance on the frame, with the clamped Jacobian and the dilation."""
    x, y, z = in_view
    tan_x, tan_y = camera.width / (2 * camera.fx), camera.height / (2 * camera.fy)
    left, right = -camera.cx / camera.fx, (camera.width - camera.cx) / camera.fx
    top, bottom = -camera.cy / camera.fy, (camera.height - camera.cy) / camera.fy
    x = z * np.clip(x / z, left - 0.3 * tan_x, right + 0.3 * tan_x)
    y = z * np.clip(y / z, top - 0.3 * tan_y, bottom + 0.3 * tan_y)
    jacobian = np.array(
        [[camera.fx / z, 0, -camera.fx * x / z**2], [0, camera.fy / z, -camera.fy * y / z**2]]
    )
    turn = camera.extrinsics[:3, :3]
    return jacobian @ turn @ world_covariance @ turn.T @ jacobian.T + 0.3 * np.eye(2)


def draw(
    gaussians: Gaussians,
    camera: Camera,
    background: tuple[float, ...],
    near: float,
    antialias: bool = False,
) -> Expected:
    """The picture. All of the Gaussians must be finite."""
    means = gaussians.means.astype(np.float64)
    in_view = means @ camera.extrinsics[:3, :3].T + camera.extrinsics[:3, 3]
    xs, ys = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    shape = (camera.height, camera.width)
    colour, depth = np.zeros((*shape, 3)), np.zeros(shape)
    median, transmittance = np.zeros(shape), np.ones(shape)
    done, borderline, median_borderline = (np.zeros(shape, bool) for _ in range(3))
    for i in np.argsort(in_view[:, 2].astype(np.float32), kind="stable"):
        x, y, z = in_view[i]
        if z <= near:
            continue
        turn = rotation_matrix(gaussians.rotations[i].astype(np.float64))
        variances = gaussians.scales[i].astype(np.float64) ** 2
        covariance = frame_covariance(in_view[i], turn * variances @ turn.T, camera)
        inverse = np.linalg.inv(covariance)
        opacity = np.float64(gaussians.opacities[i])
        if antialias:  # as much light as without the dilation
            sharp = np.linalg.det(covariance - 0.3 * np.eye(2))
            opacity *= np.sqrt(max(sharp, 0) / np.linalg.det(covariance))
        dx = xs - (camera.fx * x / z + camera.cx)
        dy = ys - (camera.fy * y / z + camera.cy)
        power = inverse[0, 0] * dx**2 + 2 * inverse[0, 1] * dx * dy + inverse[1, 1] * dy**2
        alpha = np.minimum(0.99, opacity * np.exp(-0.5 * power))
        seen = (alpha >= 1 / 255) & ~done
        after = transmittance * (1 - alpha)
        borderline |= ~done & (np.abs(alpha * 255 - 1) < BAND)
        borderline |= seen & (np.abs(after / 1e-4 - 1) < BAND)
        done |= seen & (after < 1e-4)
        weight = np.where(seen & ~done, alpha * transmittance, 0)
        colour += weight[..., None] * np.maximum(gaussians.colours[i].astype(np.float64), 0)
        depth += weight * z
        median_borderline |= seen & (np.abs(transmittance - 0.5) < BAND)
        median = np.where(seen & ~done & (transmittance > 0.5), z, median)
        transmittance = np.where(seen & ~done, after, transmittance)
    alpha = 1 - transmittance
    colour += transmittance[..., None] * np.array(background)
    depth = np.divide(depth, alpha, out=np.zeros(shape), where=alpha > 0)
    return Expected(colour, alpha, depth, median, borderline, median_borderline)
