"""A camera's picture of a scene: the splat renderer's public edge."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import FloatArray, Gaussians
from styl3r_cli.splatting.blending import (
    LANES,
    MEDIAN_DEPTH,
    PLANES,
    TRANSMITTANCE,
    blend,
    room_for,
)
from styl3r_cli.splatting.compiler import parallel_for
from styl3r_cli.splatting.constants import TILE
from styl3r_cli.splatting.projection import INVALID, Splats, near_plane, project
from styl3r_cli.splatting.tiles import tile_lists


@dataclass(frozen=True)
class Frame:
    """One rendered picture.

    Attributes:
        colour: (H, W, 3) float32 sRGB, weighted by alpha, over the background if there is one.
            Never negative; above 1 where the Gaussians' colours are.
        alpha: (H, W) float32 in [0, 1], how much of the background is hidden.
        depth: (H, W) float32, mean view z of what is seen, in scene units; 0 where alpha is 0.
        median_depth: (H, W) float32, view z of the Gaussian at which the background is half
            hidden, or of the last one where it never is; 0 where alpha is 0.
        invalid: how many Gaussians were left out because they are not finite or degenerate.
    """

    colour: FloatArray
    alpha: FloatArray
    depth: FloatArray
    median_depth: FloatArray
    invalid: int


def render(
    gaussians: Gaussians,
    camera: Camera,
    background: tuple[float, float, float] | None = (0.0, 0.0, 0.0),
    *,
    near: float | None = None,
    threads: int | None = None,
    antialias: bool = False,
    tile: int = TILE,
) -> Frame:
    """Draw Gaussians as a camera sees them (EWA splatting; Kerbl et al. 2023, section 4).

    The picture depends on the scene and the camera alone: not a bit on the number of threads or
    the tiles, and on the order of the Gaussians only where two have the same depth (the first is
    in front).

    Args:
        gaussians: the scene. Negative colours count as 0.
        camera: where from, and how large a picture; at least 1x1.
        background: sRGB colour behind the scene; None leaves it out (the same as black).
        near: view z up to which nothing is drawn; by default from the scene's size (near_plane).
        threads: how many to use; None for every core.
        antialias: draw Gaussians that are smaller than a pixel as faint as they are, instead of as
            strong as if they filled it (for cameras much farther away than the photos').
        tile: side of the squares that the work is cut into, pixels; a multiple of 8.

    Raises:
        ValueError: if the camera is not finite or has no focal length or pixels, the near plane is
            not a number, or the tiles have another size.
    """
    if tile < LANES or tile % LANES:
        raise ValueError(f"tiles of {tile} pixels: not a multiple of {LANES}")
    near = near_plane(gaussians.means) if near is None else near
    if math.isnan(near):
        raise ValueError("the near plane is not a number")
    splats = project(gaussians, camera, near, threads, antialias)
    planes = accumulate(splats, gaussians.colours, camera, threads, tile)
    transmittance = planes[TRANSMITTANCE]
    colour = np.empty((camera.height, camera.width, 3), np.float32)
    for channel in range(3):
        behind = 0.0 if background is None else background[channel]
        colour[..., channel] = planes[channel] + transmittance * np.float32(behind)
    alpha = 1 - transmittance
    depth = np.divide(planes[3], alpha, out=np.zeros_like(alpha), where=alpha > 0)
    invalid = int(np.count_nonzero(splats.status == INVALID))
    return Frame(colour, alpha, depth, planes[MEDIAN_DEPTH], invalid)


def accumulate(
    splats: Splats, colours: FloatArray, camera: Camera, threads: int | None, tile: int = TILE
) -> FloatArray:
    """Blend splats into (PLANES, H, W).

    The planes are weighted red, green, blue and depth, then transmittance and median depth.
    """
    planes = np.empty((PLANES, camera.height, camera.width), np.float32)
    for band in tile_lists(splats, camera.width, camera.height, tile, threads):
        parallel_for(
            blend, len(band.starts) - 1, threads,
            band.first, band.columns, band.tile, band.starts, band.members,
            splats.rects, splats.records, colours, camera.width, camera.height, planes.reshape(-1),
            costs=band.costs, scratch=lambda: room_for(tile),
        )  # fmt: skip
    return planes
