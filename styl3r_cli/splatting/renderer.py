"""A camera's picture of a scene: the splat renderer's public edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import FloatArray, Gaussians
from styl3r_cli.splatting.blending import PLANES, blend
from styl3r_cli.splatting.compiler import parallel_for
from styl3r_cli.splatting.projection import INVALID, Splats, near_plane, project
from styl3r_cli.splatting.tiles import depth_order, min_bands, tile_count


@dataclass(frozen=True)
class Frame:
    """One rendered picture.

    Attributes:
        colour: (H, W, 3) float32 sRGB, weighted by alpha, over the background if there is one.
            Never negative; above 1 where the Gaussians' colours are.
        alpha: (H, W) float32 in [0, 1], how much of the background is hidden.
        depth: (H, W) float32, mean view z of what is seen, in scene units; 0 where alpha is 0.
        invalid: how many Gaussians were left out because they are not finite or degenerate.
    """

    colour: FloatArray
    alpha: FloatArray
    depth: FloatArray
    invalid: int


def render(
    gaussians: Gaussians,
    camera: Camera,
    background: tuple[float, float, float] | None = (0.0, 0.0, 0.0),
    *,
    near: float | None = None,
    threads: int | None = None,
) -> Frame:
    """Draw Gaussians as a camera sees them (EWA splatting; Kerbl et al. 2023, section 4).

    The picture depends on the arguments alone: not on the number of threads, and on the order of
    the Gaussians only where two have the same depth (the first is in front).

    Args:
        gaussians: the scene. Negative colours count as 0.
        camera: where from, and how large a picture; at least 1x1.
        background: sRGB colour behind the scene; None leaves it out (the same as black).
        near: view z up to which nothing is drawn; by default from the scene's size (near_plane).
        threads: how many to use; None for every core.

    Raises:
        ValueError: if the camera is not finite or has no focal length or pixels.
    """
    near = near_plane(gaussians.means) if near is None else near
    splats = project(gaussians, camera, near, threads)
    planes = accumulate(splats, gaussians.colours, camera, threads)
    transmittance = planes[4]
    colour = np.empty((camera.height, camera.width, 3), np.float32)
    for channel in range(3):
        behind = 0.0 if background is None else background[channel]
        colour[..., channel] = planes[channel] + transmittance * np.float32(behind)
    alpha = 1 - transmittance
    depth = np.divide(planes[3], alpha, out=np.zeros_like(alpha), where=alpha > 0)
    return Frame(colour, alpha, depth, int(np.count_nonzero(splats.status == INVALID)))


def accumulate(
    splats: Splats, colours: FloatArray, camera: Camera, threads: int | None
) -> FloatArray:
    """Blend splats into (5, H, W): weighted red, green, blue and depth, and transmittance."""
    planes = np.empty((PLANES, camera.height, camera.width), np.float32)
    order = depth_order(splats)
    rects = splats.rects[order]
    parallel_for(
        blend, tile_count(camera.height), threads,
        order, rects, splats.records, colours, planes, min_parts=min_bands(rects),
    )  # fmt: skip
    return planes
