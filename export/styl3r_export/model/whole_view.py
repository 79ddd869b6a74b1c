"""A first guess of a flow: where in the whole other picture each place was most likely found."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional as F

from styl3r_export.model.subpixel import around

# Cells a side that are compared as one: a guess need only be within the recurrent flow's reach.
COARSE = 2
# Coarse cells to each side that are compared along with a cell: repeated patterns look alike, their
# surroundings less so.
BESIDE = 1
# Factor on the mean correlation before the softmax. On real pairs twice as much found slightly
# worse cameras.
SHARPNESS = 4.0
# Guesses are averaged over so many coarse cells to each side, each time without those that the time
# before left too far from the mean (a guess that is half of the reach off counts half).
REACHES = (4, 2, 1)
# Mean likelihood at which a guess counts half: where nothing was found, flows start from 0.
LEAST_LIKELY = 1e-3
# Keeps the mean of no likely places finite.
TINY = 1e-12


@torch.no_grad()
def first_guess(
    source: Float[Tensor, "batch c h w"], target: Float[Tensor, "batch c h w"]
) -> Float[Tensor, "batch 2 h w"]:
    """Where the source's cells probably are in the target, x and y in cells.

    A recurrent flow looks around where it is. From no motion at all it takes most of its rounds to
    get where the match is, and may not get there. Every place of the source is therefore compared
    with all of the target first, at half the resolution: likely is what each of the two would
    choose of all places in the other's picture (both softmaxes multiplied). What its surroundings
    do not agree with is left out, and what is left is spread over the gaps.

    Args:
        source: features that are alike where pictures show the same, h and w multiples of `COARSE`.
        target: of the other picture.
    """
    here, there = (surroundings(F.avg_pool2d(maps.float(), COARSE)) for maps in (source, target))
    rows, columns = (size // COARSE for size in source.shape[-2:])
    scale = SHARPNESS / (2 * BESIDE + 1) ** 2 * source.shape[1] ** -0.5
    alike = here.transpose(1, 2) @ there * scale
    likely = alike.softmax(dim=2) * alike.softmax(dim=1)
    # A mean of places, not the best one: no choice here hangs on a last bit.
    share = likely.square()
    share = share / (share.sum(dim=2, keepdim=True) + TINY)
    y = torch.arange(rows, device=source.device)[:, None].expand(rows, columns)
    x = torch.arange(columns, device=source.device).expand(rows, columns)
    places = torch.stack((x, y)).flatten(1).to(share.dtype)
    guess = (share @ places.T).transpose(1, 2) - places
    worth = (share * likely).sum(dim=2)[:, None]
    return spread(*(t.unflatten(2, (rows, columns)) for t in (guess, worth)))


def surroundings(maps: Float[Tensor, "batch c h w"]) -> Float[Tensor, "batch c*window h*w"]:
    """Each cell's features and its neighbours'; beyond the border there is nothing."""
    rows, columns = maps.shape[-2:]
    padded, side = F.pad(maps, (BESIDE,) * 4), range(2 * BESIDE + 1)
    moved = [padded[..., y : y + rows, x : x + columns] for y in side for x in side]
    return torch.cat(moved, dim=1).flatten(2)


def spread(
    guess: Float[Tensor, "batch 2 h w"], likely: Float[Tensor, "batch 1 h w"]
) -> Float[Tensor, "batch 2 H W"]:
    """Coarse guesses as a smooth flow of the cells, those that disagree with the rest left out."""
    weight = likely
    for reach in REACHES:
        flow = around(guess * weight, reach) / (around(weight, reach) + LEAST_LIKELY)
        off = (guess - flow).square().sum(dim=1, keepdim=True)
        weight = likely / (1 + off / (reach / 2) ** 2)
    flow = around(guess * weight, reach) / (around(weight, reach) + LEAST_LIKELY)
    return F.interpolate(flow, scale_factor=COARSE, mode="bilinear") * COARSE
