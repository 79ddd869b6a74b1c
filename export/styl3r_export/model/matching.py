"""Softmax correlation between the first view and every other: matches given to the decoder."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from styl3r_export.model.bundle import Fit, Sides, adjust, fit
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
FIRST_OUTLIERS = (0.5, 0.28, 0.16, 0.09, 0.06)
LAST_OUTLIERS = (0.12, 0.06, 0.03)
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

    sides: Sides
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
        here = expect(joint, rays[:, :1], rays[:, 1:])
        there = expect(joint.transpose(-1, -2), rays[:, 1:], rays[:, :1])
        own, matched, weight, variance = (
            torch.cat((a.flatten(0, 1), b.flatten(0, 1))) for a, b in zip(here, there, strict=True)
        )
        one = torch.ones_like(weight)
        sides = Sides(F.pad(own, (0, 1), value=1.0), matched, weight, one, one * FLAT_STIFFNESS)
        motion, rho = adjust(standing(own), sides, FIRST_OUTLIERS)
        numbers = describe(sides, variance, rho, fit(motion, sides, rho))
        pairs = motion.translation.shape[0]
        first, rest = numbers[:pairs], numbers[pairs:]
        return matches, Pairs(sides, motion), first, rest

    def forward(
        self,
        maps: Float[Tensor, "batch views channels h w"],
        intrinsics: Float[Tensor, "batch views 3 3"],
    ) -> tuple[Float[Tensor, "batch views tokens+1 dim"], Matches, Pairs]:
        """What to add to the decoder's tokens, the matches, and the cameras they suggest."""
        rows, columns = maps.shape[-2:]
        with full_precision(maps):
            matches, pairs, first, rest = self.solve(maps, intrinsics)
        batch = (maps.shape[0], maps.shape[1] - 1)
        token0 = self.first(to_tokens(first.unflatten(0, batch), rows, columns))
        tokens = self.rest(to_tokens(rest.unflatten(0, batch), rows, columns))
        camera = self.camera(torch.cat(pairs.motion, dim=-1)).unflatten(0, batch)
        tokens = torch.cat((tokens, camera[:, :, None]), dim=2)
        token0 = F.pad(token0.mean(dim=1, keepdim=True), (0, 0, 0, 1))
        return torch.cat((token0, tokens), dim=1), matches, pairs


def standing(cells: Float[Tensor, "2*pairs cells 2"]) -> Motion:
    """The motion of cameras that stay where they are, one a pair."""
    zero = cells[: cells.shape[0] // 2, 0, :1] * 0
    return Motion(torch.cat((zero + 1, zero, zero, zero), -1), torch.cat((zero, zero, zero), -1))


class Expected(NamedTuple):
    """Cells of one view, where they match in another, how surely, and how widely."""

    own: Float[Tensor, "batch others here 2"]
    matched: Float[Tensor, "batch others here 2"]
    weight: Float[Tensor, "batch others here"]
    variance: Float[Tensor, "batch others here"]


def expect(
    joint: Float[Tensor, "batch others here there"],
    here: Float[Tensor, "batch _ here 2"],
    there: Float[Tensor, "batch _ there 2"],
) -> Expected:
    """Each cell's expected match, and the variance of where it may be."""
    confidence = joint.sum(dim=-1)
    weight = joint / (confidence[..., None] + TINY)
    expected = weight @ there
    second = (weight @ there.square().sum(dim=-1, keepdim=True)).squeeze(-1)
    variance = (second - expected.square().sum(dim=-1)).clamp_min(TINY)
    sharp = confidence / (1 + variance / SHARP**2)
    return Expected(here.expand_as(expected), expected, sharp, variance)


def describe(
    sides: Sides, variance: Tensor, rho: Tensor, fitted: Fit
) -> Float[Tensor, "2*pairs cells features"]:
    """Numbers a cell: own ray, match, shift, spread, weight, triangulated depth and its worth."""
    # Where nothing matches the expectation is noise: fade it out rather than learn to ignore it.
    own, weight = sides.rays[..., :2], sides.weight[..., None]
    numbers = (variance.log(), sides.weight, (sides.weight + TINY).log(), rho.log())
    worth = ((fitted.information + TINY).log(), fitted.error.log())
    scalars = torch.stack((*numbers, *worth), dim=-1)
    shift = (sides.matched - own) * weight
    return torch.cat((own, sides.matched * weight, shift, scalars), dim=-1)


def cell_centres(t: Float[Tensor, "batch views H W"]) -> Float[Tensor, "batch views cells"]:
    """Values at the cells' centres.

    Depth changes less within a cell than it differs between a cell's centre and its mean, so the
    four pixels at the centre stand for it.
    """
    return F.avg_pool2d(t[..., 3:-3, 3:-3], 2, 8).flatten(2)


def settle(
    pairs: Pairs, guess: Motion, depth: Float[Tensor, "batch views H W"], log_error: Tensor
) -> Motion:
    """The motion once more, now with decoded depths and their expected relative errors."""
    others = depth.shape[1] - 1
    depth, log_error = (cell_centres(t) for t in (depth, log_error))
    stiffness = (depth * (-log_error).exp()).square()

    def sides_of(t: Tensor) -> Tensor:
        first = t[:, :1].expand(-1, others, -1)
        return torch.cat((first.flatten(0, 1), t[:, 1:].flatten(0, 1)))

    sides = pairs.sides._replace(prior=sides_of(1 / depth), stiffness=sides_of(stiffness))
    with full_precision(depth):
        return adjust(guess, sides, LAST_OUTLIERS)[0]


def to_tokens(
    cells: Float[Tensor, "batch others cells features"], rows: int, columns: int
) -> Float[Tensor, "batch others tokens 4*features"]:
    """Gather the 2x2 cells of each 16 px patch, patches row-major."""
    grid = cells.unflatten(2, (rows // 2, 2, columns // 2, 2))
    return grid.transpose(3, 4).flatten(4, 6).flatten(2, 3)
