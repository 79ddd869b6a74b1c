"""Matches between the first view and every other, cameras from them, and what tokens hear of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from styl3r_export.model.bundle import NOISE, Fit, Sides, adjust, fit
from styl3r_export.model.config import ModelConfig
from styl3r_export.model.flow import Flow, Flows
from styl3r_export.model.rotations import Motion, full_precision, rotation_matrix
from styl3r_export.model.subpixel import settle, traceable
from styl3r_export.model.whole_view import first_guess

# Numbers that describe the match of one 1/8 cell; four cells make one 16 px token.
CELL_FEATURES = 12
CELLS_PER_TOKEN = 4
# Keeps the logarithm of a confidence or a variance finite where nothing matches.
TINY = 1e-6

# Before anything is decoded, every cell is at the scene's unit depth, give or take a factor of
# about e (stiffness is the inverse square of inverse depth's expected error).
FLAT_STIFFNESS = 1.0
# Bounds of the log depth that triangulation suggests: matches that say more are mistaken.
MOST_LOG_DEPTH = 2.0
# Rotation vectors (radians) of the motions that adjustment starts from, each an orbit around the
# point at unit depth straight ahead. From one start a sixth of real pairs end in a wrong minimum;
# more starts than these hardly help.
STARTS = ((0.0, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, -0.5, 0.0), (0.4, 0.0, 0.0), (-0.4, 0.0, 0.0))
# Errors (ray units; 1 is the focal length, a cell of a 256 px picture about 0.03) at which matches
# are discounted, by iteration: from a wrong start every true match looks like an outlier first.
COARSE = (0.4, 0.4, 0.3, 0.3, 0.2, 0.2, 0.1, 0.1, 0.05, 0.05, 0.03, 0.03)
FINE = (0.05, 0.05, 0.03, 0.03, 0.02, 0.02, 0.015, 0.01)
# Matches agree with a motion up to about this error.
AGREEMENT = 0.012


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
    flows: Flows  # of both sides, (2 * pairs) first
    log_depth: Float[Tensor, "batch views h w"]  # triangulated; near 0 where matches say nothing


class StarMatching(nn.Module):
    """Match every view with the first one, and describe the matches token by token."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        dim = config.decoder_dim
        width = CELL_FEATURES * CELLS_PER_TOKEN
        self.flow = Flow(config.flow_rounds)
        self.first = nn.Sequential(nn.Linear(width, dim), nn.GELU(), nn.Linear(dim, dim))
        self.rest = nn.Sequential(nn.Linear(width, dim), nn.GELU(), nn.Linear(dim, dim))
        self.camera = nn.Linear(7, dim)

    def both_flows(
        self,
        maps: Float[Tensor, "batch views channels h w"],
        images: Float[Tensor, "batch views 3 H W"],
    ) -> Flows:
        """From the first view to every other, and behind them back from those."""
        context = self.flow.context(images.flatten(0, 1)).unflatten(0, maps.shape[:2])
        source, target = both_directions(maps)
        with full_precision(maps):
            guess = first_guess(source, target)
        return self.flow(source, target, both_directions(context)[0], guess)

    @staticmethod
    @torch.no_grad()
    def solve(flows: Flows, intrinsics: Tensor) -> tuple[Pairs, Tensor, Tensor]:
        """Cameras from flows, and what the cells of both sides of each pair know.

        Flows learn from their own errors: no gradient comes back through the cameras.
        """
        sides, variance = sides_of(flows, intrinsics)
        batch = (intrinsics.shape[0], intrinsics.shape[1] - 1)
        start = best_start(sides, batch[0] * batch[1], flows.log_spread.shape[-2:])
        motion, rho = adjust(start, sides, FINE)
        fitted = fit(motion, sides, rho)
        numbers = describe(sides, variance, rho, fitted)
        depth = triangulated(rho, fitted, batch).unflatten(-1, flows.log_spread.shape[-2:])
        pairs = motion.translation.shape[0]
        return Pairs(sides, motion, flows, depth), numbers[:pairs], numbers[pairs:]

    def forward(
        self,
        maps: Float[Tensor, "batch views channels h w"],
        images: Float[Tensor, "batch views 3 H W"],
        intrinsics: Float[Tensor, "batch views 3 3"],
    ) -> tuple[Float[Tensor, "batch views tokens+1 dim"], Pairs]:
        """What to add to the decoder's tokens, the matches, and the cameras they suggest."""
        rows, columns = maps.shape[-2:]
        flows = self.both_flows(maps, images)
        with full_precision(maps), torch.no_grad():
            traced = traceable((images.float().flatten(0, 1) + 1) / 2)
            settled = settle(flows, *both_directions(traced.unflatten(0, maps.shape[:2])))
            pairs, first, rest = self.solve(settled, intrinsics)
        pairs = pairs._replace(flows=flows)  # what training compares with the truth
        batch = (maps.shape[0], maps.shape[1] - 1)
        token0 = self.first(to_tokens(first.unflatten(0, batch), rows, columns))
        tokens = self.rest(to_tokens(rest.unflatten(0, batch), rows, columns))
        camera = self.camera(torch.cat(pairs.motion, dim=-1)).unflatten(0, batch)
        tokens = torch.cat((tokens, camera[:, :, None]), dim=2)
        token0 = F.pad(token0.mean(dim=1, keepdim=True), (0, 0, 0, 1))
        return torch.cat((token0, tokens), dim=1), pairs


def both_directions(
    views: Float[Tensor, "batch views ..."],
) -> tuple[Float[Tensor, "2*pairs ..."], Float[Tensor, "2*pairs ..."]]:
    """What every match leads from, and what it leads to: each pair there, behind them each back."""
    rest = views[:, 1:]
    first, rest = views[:, :1].expand_as(rest).flatten(0, 1), rest.flatten(0, 1)
    return torch.cat((first, rest)), torch.cat((rest, first))


def triangulated(
    rho: Float[Tensor, "2*pairs cells"], fitted: Fit, pairs: tuple[int, int]
) -> Float[Tensor, "batch views cells"]:
    """Log depths of all views: the first view's are the mean of its pairs', by their worth."""
    log_depth = -rho.log().clamp(-MOST_LOG_DEPTH, MOST_LOG_DEPTH)
    count = pairs[0] * pairs[1]
    first, rest = (t.unflatten(0, pairs) for t in (log_depth[:count], log_depth[count:]))
    worth = fitted.information[:count].unflatten(0, pairs) + TINY
    mean = (first * worth).sum(dim=1) / worth.sum(dim=1)
    return torch.cat((mean[:, None], rest), dim=1)


def best_start(sides: Sides, pairs: int, grid: Sequence[int]) -> Motion:
    """The motion of each pair that most matches agree with, of those found from every start.

    Every fourth cell is enough to tell.
    """
    few = Sides(*(t.unflatten(1, grid)[:, ::2, ::2].flatten(1, 2) for t in sides))
    tried = Sides(*(repeat_pairs(t, pairs) for t in few))
    found, rho = adjust(starts(sides.rays, pairs), tried, COARSE)
    error = fit(found, tried, rho).error
    agreed = (tried.weight / (1 + (error / AGREEMENT).square()).square()).sum(dim=-1)
    agreed = agreed.unflatten(0, (2, len(STARTS), pairs)).sum(dim=0)
    best = agreed.argmax(dim=0)[None, :, None]
    rotation, translation = (
        t.unflatten(0, (len(STARTS), pairs)).gather(0, best.expand(-1, -1, t.shape[-1]))[0]
        for t in found
    )
    return Motion(rotation, translation)


def repeat_pairs(t: Float[Tensor, "2*pairs ..."], pairs: int) -> Float[Tensor, "2*tries ..."]:
    """All pairs once for each start, first views before the others as before."""
    first, rest = t[:pairs], t[pairs:]
    return torch.cat((first,) * len(STARTS) + (rest,) * len(STARTS))


def starts(like: Tensor, pairs: int) -> Motion:
    """The starting motions, one block of pairs for each."""
    turns = torch.tensor(STARTS, device=like.device)
    half = turns.norm(dim=-1, keepdim=True) / 2
    axis = F.normalize(turns, dim=-1)
    rotation = torch.cat((half.cos(), half.sin() * axis), dim=-1)
    ahead = torch.tensor([0.0, 0.0, 1.0], device=like.device)
    translation = ahead - rotation_matrix(rotation) @ ahead
    return Motion(
        *(t[:, None].expand(-1, pairs, -1).flatten(0, 1) for t in (rotation, translation))
    )


def sides_of(
    flows: Flows, intrinsics: Float[Tensor, "batch views 3 3"]
) -> tuple[Sides, Float[Tensor, "2*pairs cells"]]:
    """Both sides of every pair at unit depth, weighed by their matches' worth, and its variance.

    A match's variance adds the network's expected error to how far there and back misses the
    start; a match outside the other picture has no weight.
    """
    flow = flows.rounds[-1]
    rows, columns = flow.shape[-2:]
    others = intrinsics.shape[1] - 1
    first = intrinsics[:, :1].expand(-1, others, -1, -1).flatten(0, 1)
    rest = intrinsics[:, 1:].flatten(0, 1)
    here, there = torch.cat((first, rest)), torch.cat((rest, first))
    own = cell_rays(here, rows, columns)
    y = torch.arange(rows, device=flow.device)[:, None]
    x = torch.arange(columns, device=flow.device)
    at = torch.stack((flow[:, 0] + x, flow[:, 1] + y), dim=-1)  # in the other's cells
    matched = rays_at(at, there)
    pairs = first.shape[0]
    other = torch.cat((flow[pairs:], flow[:pairs]))
    unit = torch.stack((at[..., 0] / (x.sum() * 0 + columns - 1), at[..., 1] / (rows - 1)), -1)
    grid = 2 * unit - 1
    inside = (grid.abs() <= 1).all(dim=-1).flatten(1).to(flow.dtype)
    back = F.grid_sample(other, grid, align_corners=True, padding_mode="border")
    missed = flow + back
    cell = 1 / (rows * here[:, 1, 1, None])  # one cell in ray units
    spread = flows.log_spread.exp().flatten(1) * cell
    variance = spread.square() + missed.square().sum(dim=1).flatten(1) * cell.square()
    weight = inside * NOISE**2 / (NOISE**2 + variance)
    one = torch.ones_like(weight)
    rays = F.pad(own, (0, 1), value=1.0)
    return Sides(rays, matched, weight, one, one * FLAT_STIFFNESS), variance + TINY


def rays_at(
    cells: Float[Tensor, "n rows columns 2"], intrinsics: Float[Tensor, "n 3 3"]
) -> Float[Tensor, "n cells 2"]:
    """(x/z, y/z) through places given in cells (x, y), cell centres at whole numbers."""
    rows, columns = cells.shape[1:3]
    k = intrinsics[:, None, None]
    x = ((cells[..., 0] + 0.5) / columns - k[..., 0, 2]) / k[..., 0, 0]
    y = ((cells[..., 1] + 0.5) / rows - k[..., 1, 2]) / k[..., 1, 1]
    return torch.stack((x, y), dim=-1).flatten(1, 2)


def describe(
    sides: Sides, variance: Tensor, rho: Tensor, fitted: Fit
) -> Float[Tensor, "2*pairs cells features"]:
    """Numbers a cell: own ray, match, shift, spread, weight, triangulated depth and its worth."""
    # Where nothing matches the place is noise: fade it out rather than learn to ignore it.
    own, weight = sides.rays[..., :2], sides.weight[..., None]
    numbers = (variance.log(), sides.weight, (sides.weight + TINY).log(), rho.log())
    worth = ((fitted.information / NOISE**2 + TINY).log(), fitted.error.log())
    scalars = torch.stack((*numbers, *worth), dim=-1)
    shift = (sides.matched - own) * weight
    return torch.cat((own, sides.matched * weight, shift, scalars), dim=-1)


def cell_centres(t: Float[Tensor, "batch views H W"]) -> Float[Tensor, "batch views cells"]:
    """Values at the cells' centres.

    Depth changes less within a cell than it differs between a cell's centre and its mean, so the
    four pixels at the centre stand for it.
    """
    return F.avg_pool2d(t[..., 3:-3, 3:-3], 2, 8).flatten(2)


def to_tokens(
    cells: Float[Tensor, "batch others cells features"], rows: int, columns: int
) -> Float[Tensor, "batch others tokens 4*features"]:
    """Gather the 2x2 cells of each 16 px patch, patches row-major."""
    grid = cells.unflatten(2, (rows // 2, 2, columns // 2, 2))
    return grid.transpose(3, 4).flatten(4, 6).flatten(2, 3)
