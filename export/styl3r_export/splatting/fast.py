"""A differentiable splat renderer for training on a CPU: the renderer's kernels under autograd."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import FloatArray, Gaussians
from styl3r_cli.splatting.blending import TRANSMITTANCE
from styl3r_cli.splatting.compiler import parallel_for
from styl3r_cli.splatting.constants import TILE
from styl3r_cli.splatting.projection import VISIBLE, Splats, lens_of, near_plane, project, view_of
from styl3r_cli.splatting.renderer import accumulate
from styl3r_cli.splatting.tiles import tile_lists
from styl3r_export.splatting.gradients import SUMS, unblend
from styl3r_export.splatting.unprojection import unproject


def splat(
    means: Float[Tensor, "gaussians 3"],
    scales: Float[Tensor, "gaussians 3"],
    rotations: Float[Tensor, "gaussians 4"],
    opacities: Float[Tensor, " gaussians"],
    colours: Float[Tensor, "gaussians 3"],
    extrinsics: Float[Tensor, "4 4"],
    intrinsics: Float[Tensor, "3 3"],
    size: tuple[int, int],
    background: tuple[float, float, float] | Float[Tensor, " 3"] | None = (0.0, 0.0, 0.0),
    *,
    near: float | None = None,
    threads: int | None = None,
) -> tuple[
    Float[Tensor, "3 height width"], Float[Tensor, "height width"], Float[Tensor, "height width"]
]:
    """Draw Gaussians as a camera sees them, with gradients to everything but the camera.

    The picture is that of ``styl3r_cli.splatting.render``, and of ``reference.splat``, whose
    gradients it has too. Works in float32 on the CPU, whatever it is given. Gaussians that the
    camera does not see, and ones that are not finite, get zero gradients.

    Args:
        means: centres in the world.
        scales: standard deviations.
        rotations: quaternions w x y z, of any length but 0.
        opacities: in [0, 1].
        colours: sRGB; negative ones count as 0, without gradient.
        extrinsics: world-to-camera.
        intrinsics: in pixels.
        size: height and width.
        background: sRGB behind the scene (gradients reach a tensor); None for black.
        near: view z up to which nothing is drawn; by default from the scene's size.
        threads: how many to use; None for every core.

    Returns:
        colour over the background, alpha, and mean view z of what is seen (0 where alpha is 0).
    """
    view, lens = (value.detach().cpu().double().numpy() for value in (extrinsics, intrinsics))
    camera = Camera(view, lens[0, 0], lens[1, 1], lens[0, 2], lens[1, 2], size[1], size[0])
    inputs = [
        value.float().cpu() for value in (means, scales, rotations, opacities, colours.clamp(min=0))
    ]
    if near is None:
        near = near_plane(inputs[0].detach().numpy())
    weighted, alpha = _Splat.apply(*inputs, camera, near, threads)
    behind = torch.zeros(3) if background is None else torch.as_tensor(background).float()
    colour = weighted[:3] + (1 - alpha) * behind[:, None, None]
    seen = alpha > 0
    depth = torch.where(seen, weighted[3] / torch.where(seen, alpha, 1.0), 0.0)
    return colour, alpha, depth


class _Splat(torch.autograd.Function):
    """Weighted red, green, blue and depth (4, H, W), and alpha (H, W)."""

    @staticmethod
    def forward(ctx: Any, *arguments: Any) -> tuple[Tensor, Tensor]:
        *tensors, camera, near, threads = arguments
        gaussians = Gaussians(*(tensor.detach().numpy() for tensor in tensors))
        splats = project(gaussians, camera, near, threads)
        planes = accumulate(splats, gaussians.colours, camera, threads)
        ctx.save_for_backward(*tensors)
        ctx.kept = _Kept(gaussians, camera, splats, planes, threads)
        return torch.from_numpy(planes[:4]), torch.from_numpy(1 - planes[TRANSMITTANCE])

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        _ = ctx.saved_tensors  # raises if one was changed in place since: the arrays are views
        incoming = np.concatenate([gradients[0].numpy(), gradients[1].numpy()[None]])
        results = _backward(ctx.kept, incoming)
        return (*map(torch.from_numpy, results), None, None, None)


@dataclass(frozen=True)
class _Kept:
    """What the way back needs of the way forth (the arrays are views of the tensors)."""

    gaussians: Gaussians
    camera: Camera
    splats: Splats
    planes: FloatArray
    threads: int | None


def _backward(kept: _Kept, incoming: FloatArray) -> list[FloatArray]:
    """Gradients of the five arrays of Gaussians, from those of weighted planes and alpha."""
    gaussians, camera, splats = kept.gaussians, kept.camera, kept.splats
    total = np.einsum("chw,chw->hw", incoming[:4], kept.planes[:4])
    total += incoming[4] * (1 - kept.planes[TRANSMITTANCE])
    slots = _pair_slots(splats)
    pairs = np.zeros((slots[-1], SUMS), np.float32)
    for band in tile_lists(splats, camera.width, camera.height, TILE, kept.threads):
        parallel_for(
            unblend, len(band.starts) - 1, kept.threads,
            band.first, band.columns, band.starts, band.members, splats.rects, splats.records,
            gaussians.colours, incoming, total, slots, pairs, costs=band.costs,
        )  # fmt: skip
    arrays = (gaussians.means, gaussians.scales, gaussians.rotations, gaussians.opacities)
    results = [np.zeros_like(array) for array in (*arrays, gaussians.colours)]
    view = np.array(view_of(camera))
    parallel_for(
        unproject, len(gaussians), kept.threads,
        *arrays, view, lens_of(camera), camera.height, camera.width,
        splats.status, splats.records, slots, pairs, *results,
    )  # fmt: skip
    return results


def _pair_slots(splats: Splats) -> NDArray[np.int64]:
    """(G + 1,) where each splat's (splat, tile) pairs start; none for the invisible."""
    tiles = splats.rects.astype(np.int64) // TILE
    spans = tiles[:, 2:] - tiles[:, :2] + 1
    areas = np.where(splats.status == VISIBLE, spans[:, 0] * spans[:, 1], 0)
    return np.concatenate([[0], np.cumsum(areas)])
