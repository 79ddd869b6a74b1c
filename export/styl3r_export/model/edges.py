"""Depths that jump where pictures do: each pixel takes the near or the far side of an edge."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from styl3r_export.model.adapter import pixel_rays
from styl3r_export.model.bundle import BothWays, both_ways
from styl3r_export.model.matching import both_directions
from styl3r_export.model.rotations import Motion, full_precision
from styl3r_export.model.subpixel import around, comparable, grey, within


class Stage(NamedTuple):
    """One choice of every pixel between its own depth and its surroundings'."""

    shrink: int  # the pictures' size is divided by this
    reaches: tuple[int, ...]  # pixels to each side in which the nearest and farthest are found
    window: int  # pixels to each side over which costs are compared


# Matches live on cells of 8 pixels and a decoded edge is a slope about as wide: depths of both its
# sides are found within 8 pixels. At half the size that costs a quarter and loses next to nothing;
# what is left at full size are the last two pixels.
STAGES = (Stage(2, (4, 2), 2), Stage(1, (2,), 3))
# How much more a difference in each colour counts than one in `comparable` brightness.
COLOUR_WEIGHT = 4 / 3
# Cost at which a pixel is simply another one, and cost where the other view shows nothing. In units
# of colour difference, [0, 1].
ANOTHER, UNSEEN = 0.5, 0.4
# Gain in cost for which a pixel leaves its decoded depth: less is noise, which would tear surfaces.
# The second number is added for a change by a third or more, in proportion for less.
WORTH_A_MOVE, WORTH_FAR = 0.02, 0.02
FAR = 0.3  # of log depth
# Costs as close as that share the pixel: what hung on a last bit would differ between runtimes.
CLOSE_CALL = 0.004
# Square of the differences of brightness that are taken for an edge in the picture (He et al.).
EDGE = 0.01
# Keeps a point's projection finite when it is beside or behind the other camera.
FRONT = 1e-3


def snap(
    depth: Float[Tensor, "batch views H W"],
    motion: Motion,
    images: Float[Tensor, "batch views 3 H W"],
    intrinsics: Float[Tensor, "batch views 3 3"],
) -> Float[Tensor, "batch views H W"]:
    """Depths with the edges that the pictures have.

    A pixel beside an edge was decoded as something between both sides' depths, where nothing is.
    Each pixel chooses between its own depth and the nearest and the farthest around it: the one at
    which it looks most like what the other view shows there, costs averaged over its surroundings
    as far as these have its brightness (cost-volume filtering with the guided filter: Rhemann et
    al., CVPR 2011; He et al., ECCV 2010).

    Args:
        depth: along each view's z axis; H and W multiples of 16.
        motion: first view to every other, (batch * others) pairs.
        images: in [0, 1].
        intrinsics: normalised by width and height.
    """
    with full_precision(depth):
        for stage in STAGES:
            depth = choose(stage, depth, motion, images, intrinsics)
        return median(depth.flatten(0, 1)[:, None])[:, 0].unflatten(0, depth.shape[:2])


def choose(
    stage: Stage, depth: Tensor, motion: Motion, images: Tensor, intrinsics: Tensor
) -> Float[Tensor, "batch views H W"]:
    """One stage. What smaller pictures decide is a factor for all pixels under theirs."""
    shape, small = depth.shape[:2], images.flatten(0, 1)
    whole = depth.flatten(0, 1)[:, None]
    own = whole
    if stage.shrink > 1:
        small, own = F.avg_pool2d(small, stage.shrink), F.avg_pool2d(own, stage.shrink)
    candidates = torch.cat([own, *(side for r in stage.reaches for side in sides(own, r))], dim=1)
    looks = torch.cat((small * COLOUR_WEIGHT, comparable(grey(small))), dim=1)
    costs = dissimilarity(
        candidates.unflatten(0, shape), looks.unflatten(0, shape), motion, intrinsics
    )
    costs = guided(costs, grey(small), stage.window) + prices(candidates)
    shares = (-costs / CLOSE_CALL).softmax(dim=1)
    best = (shares * candidates.log()).sum(dim=1, keepdim=True).exp()
    if stage.shrink > 1:
        larger = F.interpolate(
            torch.cat((best / own, candidates[:, 1:3]), dim=1), scale_factor=stage.shrink
        )
        factor, far, near = larger.split(1, dim=1)
        best = (whole * factor).clamp(near, far)
    return best[:, 0].unflatten(0, shape)


def sides(depth: Float[Tensor, "n 1 H W"], reach: int) -> tuple[Tensor, Tensor]:
    """The farthest and the nearest depth around each pixel."""
    size = 2 * reach + 1
    return F.max_pool2d(depth, size, 1, reach), -F.max_pool2d(-depth, size, 1, reach)


def prices(candidates: Float[Tensor, "n choices H W"]) -> Float[Tensor, "n choices H W"]:
    """What each choice costs of itself: nothing for the first one, which is to stay."""
    moved = (candidates[:, 1:] / candidates[:, :1]).log().abs() / FAR
    return F.pad(WORTH_A_MOVE + WORTH_FAR * moved.clamp_max(1), (0, 0, 0, 0, 1, 0))


def dissimilarity(
    candidates: Float[Tensor, "batch views choices H W"],
    looks: Float[Tensor, "batch views 4 H W"],
    motion: Motion,
    intrinsics: Float[Tensor, "batch views 3 3"],
) -> Float[Tensor, "batch*views choices H W"]:
    """How unlike each pixel is to what the other view shows at each depth, in units of colour.

    The first view is compared with all others, every other one with the first.
    """
    here, _ = both_directions(candidates)
    own, other = both_directions(looks)
    lens, other_lens = both_directions(intrinsics)
    grid = seen_at(here, both_ways(motion), lens, other_lens)
    seen = within(grid)
    # All choices below one another: one picture to sample serves them.
    sampled = F.grid_sample(
        other, grid.flatten(1, 2), align_corners=False, padding_mode="border"
    ).unflatten(2, seen.shape[1:3])
    unlike = (sampled - own[:, :, None]).abs().mean(dim=1) * (own.shape[1] / (COLOUR_WEIGHT * 3))
    unlike = UNSEEN + seen * (unlike.clamp_max(ANOTHER) - UNSEEN)
    batch, others = candidates.shape[0], candidates.shape[1] - 1
    first, rest = unlike.unflatten(0, (2, batch, others)).unbind(0)
    return torch.cat((first.mean(dim=1, keepdim=True), rest), dim=1).flatten(0, 1)


def seen_at(
    depth: Float[Tensor, "n choices H W"],
    both: BothWays,
    lens: Float[Tensor, "n 3 3"],
    other_lens: Float[Tensor, "n 3 3"],
) -> Float[Tensor, "n choices H W 2"]:
    """Where the other view has each pixel at each depth: x and y, its picture from -1 to 1."""
    rays = pixel_rays(lens, *depth.shape[-2:])
    turned = (rays.flatten(1, 2) @ both.rotation.transpose(-1, -2)).unflatten(1, rays.shape[1:3])
    points = turned[:, None] * depth[..., None] + both.translation[:, None, None, None]
    projected = points[..., :2] / points[..., 2:].clamp_min(FRONT)
    k = other_lens[:, None, None, None]
    focal = torch.stack((k[..., 0, 0], k[..., 1, 1]), dim=-1)
    return 2 * (projected * focal + k[..., :2, 2]) - 1


def guided(
    costs: Float[Tensor, "n choices H W"], guide: Float[Tensor, "n 1 H W"], reach: int
) -> Float[Tensor, "n choices H W"]:
    """Means over surroundings, which do not reach across the guide's edges (guided filter)."""
    centre, square = around(guide, reach), around(guide * guide, reach)
    spread = square - centre * centre + EDGE
    plain = around(costs, reach)
    slope = (around(costs * guide, reach) - plain * centre) / spread
    offset = plain - slope * centre
    return around(slope, reach) * guide + around(offset, reach)


def median(x: Float[Tensor, "n 1 H W"]) -> Float[Tensor, "n 1 H W"]:
    """Median of three rows, then of three columns: single pixels that chose alone come back."""
    x = F.pad(x, (0, 0, 1, 1), mode="replicate")
    x = middle(x[:, :, :-2], x[:, :, 1:-1], x[:, :, 2:])
    x = F.pad(x, (1, 1, 0, 0), mode="replicate")
    return middle(x[..., :-2], x[..., 1:-1], x[..., 2:])


def middle(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    """The middle one of three."""
    return torch.maximum(torch.minimum(a, b), torch.minimum(torch.maximum(a, b), c))
