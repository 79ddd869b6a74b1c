"""The plain torch renderer on the tool's own Gaussians and cameras, for timing beside it."""

from __future__ import annotations

import torch

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import Gaussians
from styl3r_export.splatting.reference import splat


def draw(scene: Gaussians, camera: Camera, threads: int) -> None:
    """Render one frame with a number of threads, and forget it."""
    torch.set_num_threads(threads)
    view, lens = (torch.from_numpy(each).float() for each in (camera.extrinsics, camera.intrinsics))
    arrays = (scene.means, scene.scales, scene.rotations, scene.opacities, scene.colours)
    means, scales, rotations, opacities, colours = map(torch.from_numpy, arrays)
    with torch.no_grad():
        size = (camera.height, camera.width)
        splat(means, scales, rotations, opacities, colours, view, lens, size)
