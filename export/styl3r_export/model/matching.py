"""Softmax correlation between the first view and every other: matches given to the decoder."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from styl3r_export.model.config import ModelConfig

# Numbers that describe the match of one 1/8 cell; four cells make one 16 px token.
CELL_FEATURES = 9
CELLS_PER_TOKEN = 4
# Keeps the logarithm of a confidence or a variance finite where nothing matches.
TINY = 1e-6

# Sharpness of the softmax at the start: flow features matched real photos best at 2 to 4.
INITIAL_TEMPERATURE = 3.0


class Matches(NamedTuple):
    """Log-probabilities of all cell pairs of each view with the first (view 0 left out)."""

    forward: Float[Tensor, "batch others cells cells"]  # rows: view 0's cells, over the other's
    backward: Float[Tensor, "batch others cells cells"]  # the same pairs, over view 0's cells


def cell_rays(
    intrinsics: Float[Tensor, "*batch 3 3"], rows: int, columns: int
) -> Float[Tensor, "*batch rows*columns 2"]:
    """(x/z, y/z) of the viewing ray through each cell's centre, row-major."""
    device = intrinsics.device
    y = (torch.arange(rows, device=device) + 0.5) / rows
    x = (torch.arange(columns, device=device) + 0.5) / columns
    fx, fy = intrinsics[..., 0, 0, None, None], intrinsics[..., 1, 1, None, None]
    cx, cy = intrinsics[..., 0, 2, None, None], intrinsics[..., 1, 2, None, None]
    ray_x = ((x[None, :] - cx) / fx).expand(*intrinsics.shape[:-2], rows, columns)
    ray_y = ((y[:, None] - cy) / fy).expand(*intrinsics.shape[:-2], rows, columns)
    return torch.stack((ray_x, ray_y), dim=-1).flatten(-3, -2)


class StarMatching(nn.Module):
    """Match every view with the first one, and describe the matches token by token."""

    def __init__(self, config: ModelConfig, channels: int) -> None:
        super().__init__()
        dim = config.decoder_dim
        width = CELL_FEATURES * CELLS_PER_TOKEN
        self.log_temperature = nn.Parameter(torch.tensor(math.log(INITIAL_TEMPERATURE)))
        self.first = nn.Sequential(nn.Linear(width, dim), nn.GELU(), nn.Linear(dim, dim))
        self.rest = nn.Sequential(nn.Linear(width, dim), nn.GELU(), nn.Linear(dim, dim))
        self.scale = 1 / math.sqrt(channels)

    def correlate(self, maps: Float[Tensor, "batch views channels h w"]) -> Matches:
        """Softmax over all cells of the other view, in both directions."""
        f = maps.flatten(3).float()
        corr = torch.einsum("bcp,bvcq->bvpq", f[:, 0], f[:, 1:])
        corr = corr * (self.scale * self.log_temperature.exp())
        return Matches(F.log_softmax(corr, dim=-1), F.log_softmax(corr, dim=-2))

    def forward(
        self,
        maps: Float[Tensor, "batch views channels h w"],
        intrinsics: Float[Tensor, "batch views 3 3"],
    ) -> tuple[Float[Tensor, "batch views tokens+1 dim"], Matches]:
        """What to add to the decoder's tokens (zero for the intrinsics token), and the matches."""
        rows, columns = maps.shape[-2:]
        matches = self.correlate(maps)
        rays = cell_rays(intrinsics, rows, columns)
        joint = (matches.forward + matches.backward).exp()
        first = describe(joint, rays[:, :1], rays[:, 1:])
        rest = describe(joint.transpose(-1, -2), rays[:, 1:], rays[:, :1])
        token0 = self.first(to_tokens(first, rows, columns)).mean(dim=1, keepdim=True)
        tokens = torch.cat((token0, self.rest(to_tokens(rest, rows, columns))), dim=1)
        return F.pad(tokens, (0, 0, 0, 1)), matches


def describe(
    joint: Float[Tensor, "batch others here there"],
    here: Float[Tensor, "batch _ here 2"],
    there: Float[Tensor, "batch _ there 2"],
) -> Float[Tensor, "batch others here features"]:
    """Own ray, expected ray of the match, displacement, spread and confidence of each cell."""
    confidence = joint.sum(dim=-1, keepdim=True)
    weight = joint / (confidence + TINY)
    expected = weight @ there
    second = weight @ there.square().sum(dim=-1, keepdim=True)
    variance = (second - expected.square().sum(dim=-1, keepdim=True)).clamp_min(TINY)
    own = here.expand_as(expected)
    # Where nothing matches the expectation is noise: fade it out rather than learn to ignore it.
    shift = (expected - own) * confidence
    log_confidence = (confidence + TINY).log()
    return torch.cat(
        (own, expected * confidence, shift, variance.log(), confidence, log_confidence), dim=-1
    )


def to_tokens(
    cells: Float[Tensor, "batch others cells features"], rows: int, columns: int
) -> Float[Tensor, "batch others tokens 4*features"]:
    """Gather the 2x2 cells of each 16 px patch, patches row-major."""
    grid = cells.unflatten(2, (rows // 2, 2, columns // 2, 2))
    return grid.transpose(3, 4).flatten(4, 6).flatten(2, 3)
