"""The splat renderer written out in plain torch: clear rather than fast, in float32 or float64.

Every pixel meets every Gaussian, so time grows with their product (and memory too, if there are
gradients); it is there to check the fast renderers, and their gradients with autograd's.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from styl3r_cli.splatting.constants import (
    ALPHA_MAX,
    ALPHA_MIN,
    DILATION,
    JACOBIAN_MARGIN,
    PIXEL_CENTRE,
    TRANSMITTANCE_MIN,
)

# (Gaussian, pixel) pairs that are worked on at a time: tens of megabytes a tensor.
PAIRS = 1 << 22


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
    near: float = 0.0,
    antialias: bool = False,
) -> tuple[
    Float[Tensor, "3 height width"], Float[Tensor, "height width"], Float[Tensor, "height width"]
]:
    """Draw Gaussians as a camera sees them; arguments and results as those of ``fast.splat``.

    Finite Gaussians only, and the near plane is an argument: by default all in front is drawn.
    """
    in_view = means @ extrinsics[:3, :3].T + extrinsics[:3, 3]
    kept = (in_view[:, 2] > near).nonzero()[:, 0]
    kept = kept[in_view[kept, 2].float().argsort(stable=True)]
    in_view = in_view[kept]
    centres = in_view[:, :2] / in_view[:, 2:] * intrinsics.diagonal()[:2] + intrinsics[:2, 2]
    covariances = project_covariances(
        in_view, scales[kept], rotations[kept], extrinsics, intrinsics, size
    )
    visible = opacities[kept]
    if antialias:
        sharp = torch.linalg.det(covariances - DILATION * torch.eye(2).to(means)).clamp(min=0)
        visible = visible * (sharp / torch.linalg.det(covariances)).sqrt()
    values = torch.cat([colours[kept].clamp(min=0), in_view[:, 2:]], dim=1)
    inverse = torch.linalg.inv(covariances)
    strips = pixel_centres(size).to(means).reshape(-1, 2).split(max(1, PAIRS // (len(kept) + 1)))
    blended = [blend(strip, centres, inverse, visible, values) for strip in strips]
    weighted, alpha = (torch.cat(parts).unflatten(0, size) for parts in zip(*blended, strict=True))
    behind = torch.zeros(3) if background is None else torch.as_tensor(background)
    colour = weighted[..., :3] + (1 - alpha)[..., None] * behind.to(means)
    depth = torch.where(alpha > 0, weighted[..., 3] / torch.where(alpha > 0, alpha, 1.0), 0.0)
    return colour.permute(2, 0, 1), alpha, depth


def blend(
    pixels: Float[Tensor, "pixels 2"],
    centres: Float[Tensor, "gaussians 2"],
    inverse: Float[Tensor, "gaussians 2 2"],
    opacities: Float[Tensor, " gaussians"],
    values: Float[Tensor, "gaussians channels"],
) -> tuple[Float[Tensor, "pixels channels"], Float[Tensor, " pixels"]]:
    """What some pixels see, weighted, and their alpha; the Gaussians are sorted by depth."""
    offsets = pixels - centres[:, None]
    distances = (offsets @ inverse * offsets).sum(-1)
    weights = blending_weights(opacities[:, None] * torch.exp(-0.5 * distances))
    return torch.einsum("gp,gc->pc", weights, values), weights.sum(0)


def pixel_centres(size: tuple[int, int]) -> Float[Tensor, "height width 2"]:
    """Where pixels are, x and y."""
    y, x = torch.meshgrid(torch.arange(size[0]), torch.arange(size[1]), indexing="ij")
    return torch.stack([x, y], -1) + PIXEL_CENTRE


def blending_weights(
    alphas: Float[Tensor, "gaussians pixels"],
) -> Float[Tensor, "gaussians pixels"]:
    """Each Gaussian's share of each pixel, nearest first (Kerbl et al. 2023, equation 3)."""
    alphas = alphas.clamp(max=ALPHA_MAX) * (alphas >= ALPHA_MIN)
    after = torch.cumprod(1 - alphas, 0)
    before = torch.cat([torch.ones_like(after[:1]), after[:-1]])
    # Transmittance never grows: once below the limit, a pixel stays finished.
    return alphas * before * (after >= TRANSMITTANCE_MIN)


def project_covariances(
    in_view: Float[Tensor, "gaussians 3"],
    scales: Float[Tensor, "gaussians 3"],
    rotations: Float[Tensor, "gaussians 4"],
    extrinsics: Float[Tensor, "4 4"],
    intrinsics: Float[Tensor, "3 3"],
    size: tuple[int, int],
) -> Float[Tensor, "gaussians 2 2"]:
    """Covariances on the frame, px^2, dilated (Zwicker et al. 2001, EWA splatting)."""
    focal, centre = intrinsics.diagonal()[:2], intrinsics[:2, 2]
    length = torch.tensor([size[1], size[0]]).to(in_view)
    margin = JACOBIAN_MARGIN * 0.5 * length / focal
    slopes = (in_view[:, :2] / in_view[:, 2:]).clamp(
        -centre / focal - margin, (length - centre) / focal + margin
    )
    depth = in_view[:, 2, None]
    jacobian = torch.cat(
        [torch.diag_embed(focal / depth), -(focal * slopes / depth)[..., None]], dim=-1
    )
    axes = jacobian @ extrinsics[:3, :3] @ to_matrices(rotations) * scales[:, None]
    return axes @ axes.mT + DILATION * torch.eye(2).to(in_view)


def to_matrices(rotations: Float[Tensor, "gaussians 4"]) -> Float[Tensor, "gaussians 3 3"]:
    """Rotation matrices of quaternions w x y z of any length."""
    w, x, y, z = torch.nn.functional.normalize(rotations, dim=-1).unbind(-1)
    return torch.stack(
        [
            torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        -2,
    )
