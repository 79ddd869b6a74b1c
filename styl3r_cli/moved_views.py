"""What becomes of a scene's Gaussians when a view of it is moved, or shown again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.poses import centre, to_quaternion
from styl3r_cli.cameras.similarity import size_of
from styl3r_cli.meetings import project
from styl3r_cli.pipeline import Scene

Array = NDArray[np.float64]

# A view was given up if it is so much fainter than the one that is least so.
FAINT = 0.5


def copied(scene: Scene) -> Scene:
    """A scene whose geometry may be changed."""
    return replace(
        scene,
        means=scene.means.copy(),
        scales=scene.scales.copy(),
        rotations=scene.rotations.copy(),
        opacities=scene.opacities.copy(),
    )


def move_view(scene: Scene, view: int, change: Array) -> None:
    """Move a view's Gaussians by a similarity of the world."""
    size = size_of(change)
    points = scene.means[view].astype(np.float64)
    with np.errstate(invalid="ignore"):  # what is not finite stays so
        scene.means[view] = points @ change[:3, :3].T + change[:3, 3]
    scene.scales[view] *= np.float32(size)
    w, x, y, z = to_quaternion(change[:3, :3] / size)
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    scene.rotations[view] = scene.rotations[view].astype(np.float64) @ left.T


def scale_depths(scene: Scene, view: int, camera: Camera, factors: Array) -> None:
    """Move a view's Gaussians along their rays, to depths times (H, W) factors.

    Factors that are not finite change nothing.
    """
    factors = np.where(np.isfinite(factors), factors, 1.0)[..., None]
    eye = centre(camera.extrinsics)
    with np.errstate(invalid="ignore"):  # what is not finite stays so
        scene.means[view] = eye + (scene.means[view] - eye) * factors
    scene.scales[view] *= factors.astype(np.float32)


def change_lens(scene: Scene, view: int, camera: Camera, zoom: float) -> None:
    """Move a view's Gaussians to where its pixels see them through a lens so many times as long.

    Their depths stay, and their sizes on the picture.
    """
    turn, shift = camera.extrinsics[:3, :3], camera.extrinsics[:3, 3]
    with np.errstate(invalid="ignore"):  # what is not finite stays so
        seen = scene.means[view].astype(np.float64) @ turn.T + shift
        seen[..., :2] /= zoom
        scene.means[view] = (seen - shift) @ turn
    scene.scales[view] /= np.float32(zoom)


def show_again(scene: Scene, cameras: list[Camera], sure: list[int]) -> list[int]:
    """Make views that were given up visible beyond what the others show; returns which.

    Their depths come from wrong matches: within the others' frames they would only be in the way.
    """
    middles = np.median(np.nan_to_num(scene.opacities), axis=(1, 2))
    shown = middles >= FAINT * middles.max()
    again = [view for view in sure if not shown[view]]
    for view in again:
        beyond = np.ones(scene.opacities[view].shape, np.bool_)
        for other in np.flatnonzero(shown):
            beyond &= ~_inside(scene.means[view], cameras[other])
        clear = np.maximum(scene.opacities[view], middles.max())
        scene.opacities[view] = np.where(beyond, clear, 0)
        shown[view] = True
    return [view for view in again if (scene.opacities[view] > 0).any()]


def _inside(points: NDArray[np.float32], camera: Camera) -> NDArray[np.bool_]:
    """(H, W), which points (H, W, 3) are in a camera's frame."""
    x, y, _ = project(points, camera)
    return (np.abs(x - (camera.width - 1) / 2) < camera.width / 2) & (
        np.abs(y - (camera.height - 1) / 2) < camera.height / 2
    )
