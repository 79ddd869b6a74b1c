"""Palette transfer: the views' joint colour statistics moved to a style's, in closed form."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

# Luma and two colour differences (YCbCr's, scaled): luma comes first, so that in a triangular
# transform light and dark depend on light and dark alone and the photo's structure survives.
LUMA = ((0.299, 0.587, 0.114), (-0.169, -0.331, 0.5), (0.5, -0.419, -0.081))
# Its inverse, so that the graph need not invert.
RGB = (
    (1.000000000, -0.000926745, 1.401686760),
    (1.000000000, -0.343695384, -0.714169040),
    (1.000000000, 1.772160416, 0.000990221),
)
# Added to every variance, style's and content's alike: noise of flat photos must not be
# stretched to a painting's contrast, and equal statistics must give exactly the identity.
VARIANCE_FLOOR = 4e-4
# Largest stretch of a colour direction.
MOST_STRETCH = 4.0


def transfer_palette(
    images: Float[Tensor, "batch views 3 H W"],
    style_images: Float[Tensor, "batch styles 3 h w"],
    style_weights: Float[Tensor, "batch styles"],
) -> Float[Tensor, "batch views 3 H W"]:
    """The views in the weighted palette of the styles.

    One affine transform for all views of a scene, so that views agree as the photos do. It maps
    mean and covariance of their colours to the styles' (Cholesky factors, as in linear colour
    transfer), and is the identity where the two are equal.

    Args:
        images: sRGB in [0, 1].
        style_images: sRGB in [0, 1], content photos standing in for a style as well.
        style_weights: summing to 1 in each scene.
    """
    to_luma = images.new_tensor(LUMA)
    mean, factor = moments(images.transpose(1, 2).flatten(2)[:, None], to_luma)
    style_mean, style_covariance = covariance(style_images.flatten(3), to_luma)
    weights = style_weights[..., None, None]
    style_mean = (style_mean * weights).sum(dim=1)
    style_factor = cholesky((style_covariance * weights).sum(dim=1))
    stretch = (style_factor @ lower_inverse(factor)).clamp(-MOST_STRETCH, MOST_STRETCH)
    # From RGB to RGB: out of the luma basis again, around the means.
    back = images.new_tensor(RGB)
    transform = back @ stretch @ to_luma
    offset = back @ (style_mean - stretch @ mean)
    pixels = images.flatten(3)
    moved = transform[:, None] @ pixels + offset[:, None]
    return moved.unflatten(3, images.shape[-2:])


def moments(
    pixels: Float[Tensor, "batch one 3 pixels"], to_luma: Float[Tensor, "3 3"]
) -> tuple[Float[Tensor, "batch 3 1"], Float[Tensor, "batch 3 3"]]:
    """Mean and Cholesky factor of the covariance of a scene's colours."""
    mean, spread = covariance(pixels, to_luma)
    return mean.squeeze(1), cholesky(spread.squeeze(1))


def covariance(
    pixels: Float[Tensor, "batch pictures 3 pixels"], to_luma: Float[Tensor, "3 3"]
) -> tuple[Float[Tensor, "batch pictures 3 1"], Float[Tensor, "batch pictures 3 3"]]:
    """Mean and (floored) covariance of each picture's colours in the luma basis."""
    colours = to_luma @ pixels
    mean = colours.mean(dim=-1, keepdim=True)
    centred = colours - mean
    spread = centred @ centred.transpose(-1, -2) / pixels.shape[-1]
    return mean, spread + VARIANCE_FLOOR * torch.eye(3, device=pixels.device)


def cholesky(a: Float[Tensor, "batch 3 3"]) -> Float[Tensor, "batch 3 3"]:
    """Lower factor L of a positive matrix, L L^T = a, written out."""
    l00 = a[:, 0, 0].sqrt()
    l10, l20 = a[:, 1, 0] / l00, a[:, 2, 0] / l00
    l11 = (a[:, 1, 1] - l10 * l10).clamp_min(VARIANCE_FLOOR).sqrt()
    l21 = (a[:, 2, 1] - l20 * l10) / l11
    l22 = (a[:, 2, 2] - l20 * l20 - l21 * l21).clamp_min(VARIANCE_FLOOR).sqrt()
    o = torch.zeros_like(l00)
    return torch.stack((l00, o, o, l10, l11, o, l20, l21, l22), dim=-1).unflatten(-1, (3, 3))


def lower_inverse(l: Float[Tensor, "batch 3 3"]) -> Float[Tensor, "batch 3 3"]:  # noqa: E741
    """Inverse of a lower triangular matrix, written out."""
    i00, i11, i22 = 1 / l[:, 0, 0], 1 / l[:, 1, 1], 1 / l[:, 2, 2]
    i10 = -l[:, 1, 0] * i00 * i11
    i21 = -l[:, 2, 1] * i11 * i22
    i20 = (l[:, 1, 0] * l[:, 2, 1] * i11 - l[:, 2, 0]) * i00 * i22
    o = torch.zeros_like(i00)
    return torch.stack((i00, o, o, i10, i11, o, i20, i21, i22), dim=-1).unflatten(-1, (3, 3))
