"""Matches moved by fractions of a pixel, to where the two pictures look most alike."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from styl3r_export.model.flow import Flows
from styl3r_export.model.loops import Carry, repeat

# Pixels a side of a flow's cell, and of the window around its centre that is compared. On real
# pairs windows of 10 to 16 pixels found equally good cameras; 24 better ones, but worse depths.
CELL, WINDOW = 8, 16
# Steps. On real pairs 4 found slightly worse cameras, 8 hardly better ones.
STEPS = 6
# A patch's brightness and contrast are taken out over so many pixels to each side: exposure
# differs between photos. Deviations below the second number (of a picture in [0, 1]) are noise.
SURROUNDINGS, LEAST_DEVIATION = 4, 0.03
# Added to the mean square of slopes: a cell with less than that has nothing to go by and stays.
DAMPING = 0.001
# A window's pixels move with their own cells. How much of a cell's departure from its neighbours is
# taken out of that: all of it, and each cell finds its match alone, texture or not; nothing, and
# rough flows are never mended and slowly grow.
ALONE = 0.5
# Difference (in deviations) at which a pixel loses half its weight: what one view alone sees.
OUTLIER = 0.5
# Longest step, in cells.
LONGEST_STEP = 0.15
# A cell that goes farther than the first, altogether, found something else: it comes back, wholly
# from the second on. No choice here hangs on a last bit, or runtimes would disagree.
LONG_WAY, LONGEST_WAY = 0.6, 0.8
# Binomial: what is finer than a pixel's neighbours is noise and has no slope to follow.
SMOOTHING = (0.25, 0.5, 0.25)


def settle(
    flows: Flows,
    sources: Float[Tensor, "pairs 1 H W"],
    targets: Float[Tensor, "pairs 1 H W"],
) -> Flows:
    """The last flow, every cell moved to where its surroundings fit best; expected errors stay.

    A recurrent flow on cells of 8 pixels is right to about a pixel, which is too coarse for the
    cameras of photos taken close together. Lucas and Kanade's method (1981) needs such a start and
    gets to a tenth: least squares on the difference of two pictures around each cell's centre, one
    of them moved along the flow as it is now between cells (so that windows turn and stretch with
    it), with the mean of both pictures' slopes.

    Args:
        flows: from sources to targets, in cells.
        sources: what `traceable` makes of pictures.
        targets: of those that the flow leads to.
    """
    start = flows.rounds[-1]
    slopes = slope(sources)

    def step(carry: Carry, _: float | Tensor) -> Carry:
        (flow,) = carry
        seen, inside = moved(targets, flow)
        x, y = ((slopes + slope(seen)) / 2).split(1, dim=1)
        uneven = ALONE * (flow - neighbours(flow))
        own_x, own_y = in_pixels(uneven).split(1, dim=1)
        difference = sources - seen
        weight = inside / (1 + (difference / OUTLIER).square())
        difference = difference + x * own_x + y * own_y
        products = torch.cat((x * x, x * y, y * y, x * difference, y * difference), dim=1)
        xx, xy, yy, xd, yd = windows(products * weight).unbind(dim=1)
        own_x, own_y = (uneven * CELL).unbind(dim=1)
        xd, yd = xd - xx * own_x - xy * own_y, yd - xy * own_x - yy * own_y
        xx, yy = xx + DAMPING, yy + DAMPING
        change = torch.stack((yy * xd - xy * yd, xx * yd - xy * xd), dim=1)
        change = change / (xx * yy - xy * xy)[:, None] / CELL
        length = change.square().sum(dim=1, keepdim=True)
        return (flow + change / (1 + length / LONGEST_STEP**2).sqrt(),)

    (flow,) = repeat(step, (start,), range(STEPS))
    way = flow - start
    length = (way.square().sum(dim=1, keepdim=True) + LONGEST_STEP**2).sqrt()
    kept = ((LONGEST_WAY - length) / (LONGEST_WAY - LONG_WAY)).clamp(0, 1)
    return Flows((*flows.rounds[:-1], start + kept * way), flows.log_spread)


def traceable(pictures: Float[Tensor, "n 3 H W"]) -> Float[Tensor, "n 1 H W"]:
    """Pictures in [0, 1] as `settle` compares them: the same in any light, without noise."""
    return smooth(comparable(smooth(grey(pictures))))


def grey(pictures: Float[Tensor, "n 3 H W"]) -> Float[Tensor, "n 1 H W"]:
    """The mean of the colours."""
    return pictures.mean(dim=1, keepdim=True)


def comparable(brightness: Float[Tensor, "n 1 H W"]) -> Float[Tensor, "n 1 H W"]:
    """Brightness less that of the surroundings, in units of their deviation."""
    mean, square = around(brightness), around(brightness * brightness)
    deviation = (square - mean * mean).clamp_min(0).sqrt()
    return (brightness - mean) / (deviation + LEAST_DEVIATION)


def around(x: Float[Tensor, "n c H W"], reach: int = SURROUNDINGS) -> Float[Tensor, "n c H W"]:
    """Mean over so many pixels to each side, of those within the picture."""
    size = 2 * reach + 1
    x = F.avg_pool2d(x, (size, 1), 1, (reach, 0), count_include_pad=False)
    return F.avg_pool2d(x, (1, size), 1, (0, reach), count_include_pad=False)


def smooth(x: Float[Tensor, "n 1 H W"]) -> Float[Tensor, "n 1 H W"]:
    """Binomially weighted mean of 3x3 pixels, the border repeated."""
    line = torch.tensor(SMOOTHING, dtype=x.dtype, device=x.device)
    return F.conv2d(F.pad(x, (1, 1, 1, 1), mode="replicate"), (line[:, None] * line)[None, None])


def slope(x: Float[Tensor, "n 1 H W"]) -> Float[Tensor, "n 2 H W"]:
    """Central differences along x and y, a pixel."""
    x = F.pad(x, (1, 1, 1, 1), mode="replicate")
    along_x = x[..., 1:-1, 2:] - x[..., 1:-1, :-2]
    along_y = x[..., 2:, 1:-1] - x[..., :-2, 1:-1]
    return torch.cat((along_x, along_y), dim=1) / 2


def moved(
    target: Float[Tensor, "n 1 H W"], flow: Float[Tensor, "n 2 h w"]
) -> tuple[Float[Tensor, "n 1 H W"], Float[Tensor, "n 1 H W"]]:
    """The target at each of the source's pixels, and whether it shows them (1 to 0)."""
    height, width = target.shape[-2:]
    fine = in_pixels(flow)
    x = (torch.arange(width, device=flow.device) + 0.5 + fine[:, 0]) / width
    y = (torch.arange(height, device=flow.device)[:, None] + 0.5 + fine[:, 1]) / height
    grid = 2 * torch.stack((x, y), dim=-1) - 1
    seen = F.grid_sample(target, grid, align_corners=False, padding_mode="border")
    return seen, within(grid)[:, None]


def within(grid: Float[Tensor, "*batch H W 2"]) -> Float[Tensor, "*batch H W"]:
    """1 for places (-1 to 1) in a picture of this size, falling to 0 a pixel beyond its border."""
    height, width = grid.shape[-3:-1]
    x, y = grid.abs().unbind(dim=-1)
    beyond = torch.maximum((x - 1) * (width / 2), (y - 1) * (height / 2))
    return (1 - beyond).clamp(0, 1)


def in_pixels(flow: Float[Tensor, "n 2 h w"]) -> Float[Tensor, "n 2 H W"]:
    """A flow in cells, between the cells and in pixels."""
    return F.interpolate(flow, scale_factor=CELL, mode="bilinear") * CELL


def neighbours(flow: Float[Tensor, "n 2 h w"]) -> Float[Tensor, "n 2 h w"]:
    """Mean of 3x3 cells, the border repeated."""
    return F.avg_pool2d(F.pad(flow, (1, 1, 1, 1), mode="replicate"), 3, 1)


def windows(x: Float[Tensor, "n c H W"]) -> Float[Tensor, "n c h w"]:
    """Mean over the window around each cell's centre; beyond the border there is nothing."""
    half = CELL // 2  # windows overlap: their quarters are summed up once
    return F.avg_pool2d(F.avg_pool2d(x, half), WINDOW // half, 2, (WINDOW - CELL) // CELL)
