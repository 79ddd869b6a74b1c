"""A target's camera, adjusted to its photo as it is for the published figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.poses import from_camera
from styl3r_cli.gaussians import Gaussians
from styl3r_export.model.adapter import multiply_quaternions, rotate_vectors
from styl3r_export.splatting.fast import splat

# Of Adam, on radians and on units of the inputs' baseline (as the published code has it).
LEARNING_RATE = 0.005


def adjust_pose(
    gaussians: Gaussians,
    camera: Camera,
    photo: NDArray[np.floating],
    unit: float,
    steps: int,
    threads: int,
) -> Camera:
    """Turn and move a camera so that the Gaussians look like the photo (mean squared error).

    The published evaluation does this for each target picture, because a network without camera
    poses places its world only about where the given cameras have it. The published loss also has
    0.05 LPIPS-VGG in it, whose weights need a download.

    Args:
        gaussians: in their own colours.
        camera: where to start.
        photo: (H, W, 3) in [0, 1].
        unit: distance between the first and the last input's camera, in the Gaussians' units.
        steps: of gradient descent.
        threads: for the renderer.

    Returns:
        The best camera that was met, the start included.
    """
    truth = torch.from_numpy(np.ascontiguousarray(photo.transpose(2, 0, 1), np.float32))
    still = _in_camera(gaussians, camera)
    step = torch.zeros(6, requires_grad=True)
    optimiser = torch.optim.Adam([step], lr=LEARNING_RATE)
    best, least = torch.zeros(6), float("inf")
    for _ in range(steps + 1):
        optimiser.zero_grad()
        error = (_render(still, step, camera, unit, threads) - truth).square().mean()
        if error.item() < least:
            best, least = step.detach().clone(), error.item()
        torch.autograd.backward(error)
        optimiser.step()
    turn, shift = _motion(best, unit)
    moved: NDArray[np.float64] = np.array(camera.extrinsics, np.float64)
    rotation = rotate_vectors(turn, torch.eye(3)).T.numpy().astype(np.float64)
    moved[:3] = rotation @ camera.extrinsics[:3]
    moved[:3, 3] += shift.numpy()
    return replace(camera, extrinsics=moved)


def _in_camera(gaussians: Gaussians, camera: Camera) -> list[Tensor]:
    """Means, scales, rotations, opacities and colours, in the camera's own frame."""
    rotation = camera.extrinsics[:3, :3]
    means = gaussians.means @ rotation.T + camera.extrinsics[:3, 3]
    quaternion = from_camera(
        replace(camera, extrinsics=np.linalg.inv(camera.extrinsics).astype(np.float64))
    )[:4]
    turn = torch.from_numpy(quaternion.astype(np.float32))
    rotations = multiply_quaternions(turn, torch.from_numpy(gaussians.rotations))
    rest = (torch.from_numpy(a) for a in (gaussians.opacities, gaussians.colours))
    return [
        torch.from_numpy(means.astype(np.float32)),
        torch.from_numpy(gaussians.scales),
        rotations,
        *rest,
    ]


def _motion(step: Float[Tensor, " 6"], unit: float) -> tuple[Tensor, Tensor]:
    """A unit quaternion and a translation from the optimised numbers."""
    half = torch.cat((torch.ones(1), step[:3] / 2))
    return half / half.norm(), step[3:] * unit


def _render(
    still: list[Tensor], step: Tensor, camera: Camera, unit: float, threads: int
) -> Float[Tensor, "3 height width"]:
    """The picture after moving everything in front of the camera, which is the same."""
    means, scales, rotations, opacities, colours = still
    turn, shift = _motion(step, unit)
    moved = rotate_vectors(turn, means) + shift
    turned = multiply_quaternions(turn.expand_as(rotations), rotations)
    lens = torch.from_numpy(camera.intrinsics)
    size = (camera.height, camera.width)
    arrays = (moved, scales, turned, opacities, colours)
    picture, _, _ = splat(*arrays, torch.eye(4), lens, size, threads=threads)
    return picture.clamp(0, 1)
