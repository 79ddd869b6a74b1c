"""Softmax correlation between the first view and every other: matches given to the decoder."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from styl3r_export.model.bundle import Residuals, Side, adjust, residuals
from styl3r_export.model.config import ModelConfig
from styl3r_export.model.rotations import Motion, full_precision

# Numbers that describe the match of one 1/8 cell; four cells make one 16 px token.
CELL_FEATURES = 12
CELLS_PER_TOKEN = 4
# Keeps the logarithm of a confidence or a variance finite where nothing matches.
TINY = 1e-6

# Before anything is decoded, every cell is at the scene's unit depth, give or take a factor of
# about 1.3 (stiffness is the inverse square of inverse depth's expected error).
FLAT_STIFFNESS = 10.0
# Errors at which matches are discounted, by iteration: from a standing camera, then from the
# decoder's cameras (ray units; a cell of a 256 px picture is about 0.03 wide).
FIRST_OUTLIERS = (0.5, 0.33, 0.21, 0.14, 0.09, 0.06)
LAST_OUTLIERS = (0.12, 0.08, 0.05, 0.03)
# Spread of a match (ray units) that halves its weight.
SHARP = 0.05

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


class Pairs(NamedTuple):
    """Matches of every view with the first, (batch * others) pairs, and a motion they suggest."""

    here: Side  # the first view's cells, repeated for each other view
    there: Side  # the other view's cells
    motion: Motion


class StarMatching(nn.Module):
    """Match every view with the first one, and describe the matches token by token."""

    def __init__(self, config: ModelConfig, channels: int) -> None:
        super().__init__()
        dim = config.decoder_dim
        width = CELL_FEATURES * CELLS_PER_TOKEN
        self.log_temperature = nn.Parameter(torch.tensor(math.log(INITIAL_TEMPERATURE)))
        self.first = nn.Sequential(nn.Linear(width, dim), nn.GELU(), nn.Linear(dim, dim))
        self.rest = nn.Sequential(nn.Linear(width, dim), nn.GELU(), nn.Linear(dim, dim))
        self.camera = nn.Linear(7, dim)
        self.scale = 1 / math.sqrt(channels)

    def correlate(self, maps: Float[Tensor, "batch views channels h w"]) -> Matches:
        """Softmax over all cells of the other view, in both directions."""
        f = maps.flatten(3).float()
        corr = torch.einsum("bcp,bvcq->bvpq", f[:, 0], f[:, 1:])
        corr = corr * (self.scale * self.log_temperature.exp())
        return Matches(F.log_softmax(corr, dim=-1), F.log_softmax(corr, dim=-2))

    def solve(self, maps: Tensor, intrinsics: Tensor) -> tuple[Matches, Pairs, Tensor, Tensor]:
        """Matches, cameras from them, and what the cells of both sides of each pair know."""
        rows, columns = maps.shape[-2:]
        matches = self.correlate(maps)
        rays = cell_rays(intrinsics, rows, columns)
        joint = (matches.forward + matches.backward).exp()
        here, spread_here = expect(joint, rays[:, :1], rays[:, 1:])
        there, spread_there = expect(joint.transpose(-1, -2), rays[:, 1:], rays[:, :1])
        still = Motion(*standing(here.rays))
        motion, rho_here, rho_there = adjust(still, here, there, FIRST_OUTLIERS)
        fit_here = residuals(motion, here, rho_here, back=False)
        fit_there = residuals(motion, there, rho_there, back=True)
        first = describe(here, spread_here, rho_here, fit_here)
        rest = describe(there, spread_there, rho_there, fit_there)
        return matches, Pairs(here, there, motion), first, rest

    def forward(
        self,
        maps: Float[Tensor, "batch views channels h w"],
        intrinsics: Float[Tensor, "batch views 3 3"],
    ) -> tuple[Float[Tensor, "batch views tokens+1 dim"], Matches, Pairs]:
        """What to add to the decoder's tokens, the matches, and the cameras they suggest."""
        rows, columns = maps.shape[-2:]
        with full_precision(maps):
            matches, pairs, first, rest = self.solve(maps, intrinsics)
        batch = (len(maps), maps.shape[1] - 1)
        token0 = self.first(to_tokens(first.unflatten(0, batch), rows, columns))
        tokens = self.rest(to_tokens(rest.unflatten(0, batch), rows, columns))
        camera = self.camera(torch.cat(pairs.motion, dim=-1)).unflatten(0, batch)
        tokens = torch.cat((tokens, camera[:, :, None]), dim=2)
        token0 = F.pad(token0.mean(dim=1, keepdim=True), (0, 0, 0, 1))
        return torch.cat((token0, tokens), dim=1), matches, pairs


def standing(
    rays: Float[Tensor, "pairs cells 2"],
) -> tuple[Float[Tensor, "pairs 4"], Float[Tensor, "pairs 3"]]:
    """The motion of a camera that stays where it is."""
    zero = torch.zeros_like(rays[:, 0, :1])
    return torch.cat((zero + 1, zero, zero, zero), -1), torch.cat((zero, zero, zero), -1)


def expect(
    joint: Float[Tensor, "batch others here there"],
    here: Float[Tensor, "batch _ here 2"],
    there: Float[Tensor, "batch _ there 2"],
) -> tuple[Side, Float[Tensor, "pairs here"]]:
    """Each cell's expected match, and the variance of where it may be."""
    confidence = joint.sum(dim=-1)
    weight = joint / (confidence[..., None] + TINY)
    expected = weight @ there
    second = (weight @ there.square().sum(dim=-1, keepdim=True)).squeeze(-1)
    variance = (second - expected.square().sum(dim=-1)).clamp_min(TINY)
    sharp = confidence / (1 + variance / SHARP**2)
    one = torch.ones_like(confidence)
    side = (here.expand_as(expected), expected, sharp, one, one * FLAT_STIFFNESS)
    return Side(*(t.flatten(0, 1) for t in side)), variance.flatten(0, 1)


def describe(
    side: Side, variance: Tensor, rho: Tensor, fit: Residuals
) -> Float[Tensor, "pairs cells features"]:
    """Numbers a cell: own ray, match, shift, spread, weight, triangulated depth and its worth."""
    # Where nothing matches the expectation is noise: fade it out rather than learn to ignore it.
    weight = side.weight[..., None]
    numbers = (variance.log(), side.weight, (side.weight + TINY).log(), rho.log())
    worth = ((fit.information + TINY).log(), fit.error.log())
    scalars = torch.stack((*numbers, *worth), dim=-1)
    shift = (side.matched - side.rays) * weight
    return torch.cat((side.rays, side.matched * weight, shift, scalars), dim=-1)


def settle(
    pairs: Pairs, guess: Motion, depth: Float[Tensor, "batch views cells"], log_error: Tensor
) -> Motion:
    """The motion once more, now with decoded depths and their expected relative errors."""
    others = depth.shape[1] - 1
    rho = 1 / depth
    stiffness = (depth * (-log_error).exp()).square()

    def side(cells: Side, which: slice) -> Side:
        prior, stiff = (t[:, which].expand(-1, others, -1).flatten(0, 1) for t in (rho, stiffness))
        return cells._replace(prior=prior, stiffness=stiff)

    here, there = side(pairs.here, slice(0, 1)), side(pairs.there, slice(1, None))
    with full_precision(depth):
        return adjust(guess, here, there, LAST_OUTLIERS)[0]


def to_tokens(
    cells: Float[Tensor, "batch others cells features"], rows: int, columns: int
) -> Float[Tensor, "batch others tokens 4*features"]:
    """Gather the 2x2 cells of each 16 px patch, patches row-major."""
    grid = cells.unflatten(2, (rows // 2, 2, columns // 2, 2))
    return grid.transpose(3, 4).flatten(4, 6).flatten(2, 3)
