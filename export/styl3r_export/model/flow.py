"""Dense matches between two views: RAFT-small's recurrent flow, with an expected error."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from styl3r_export.model.loops import Carry, repeat
from styl3r_export.model.stem import PyramidStem

# RAFT-small's sizes (Teed and Deng, ECCV 2020): channels of the recurrent state and of the
# context beside it, levels of the correlation pyramid, and reach of the look-up in each.
HIDDEN, CONTEXT = 96, 64
MOTION = 80  # features of the correlations and the flow; the flow itself goes beside them
LEVELS, RADIUS = 4, 3
WINDOW = 2 * RADIUS + 1
# Expected error of an untrained network, as a logarithm of cells: one pixel.
UNTRAINED_SPREAD = -2.1
# Bounds of the expected error: a fortieth of a cell, and a dozen cells.
SPREAD_MIN, SPREAD_MAX = -3.7, 2.5


class Flows(NamedTuple):
    """Where the cells of one map are in another, after each round."""

    rounds: tuple[Float[Tensor, "batch 2 h w"], ...]  # x and y, in cells; the last one counts
    log_spread: Float[Tensor, "batch h w"]  # log of the last one's expected error, in cells


class MotionEncoder(nn.Module):
    """Correlations and the present flow to features (RAFT's `BasicMotionEncoder`, small)."""

    def __init__(self) -> None:
        super().__init__()
        self.convc1 = nn.Conv2d(LEVELS * WINDOW**2, 96, 1)
        self.convf1 = nn.Conv2d(2, 64, 7, padding=3)
        self.convf2 = nn.Conv2d(64, 32, 3, padding=1)
        self.conv = nn.Conv2d(128, MOTION, 3, padding=1)

    def forward(self, costs: Tensor, flow: Tensor) -> Float[Tensor, "batch 80 h w"]:
        """Features of both."""
        cost = F.relu(self.convc1(costs))
        motion = F.relu(self.convf2(F.relu(self.convf1(flow))))
        return F.relu(self.conv(torch.cat((cost, motion), 1)))


class Gates(NamedTuple):
    """What the context adds to each gate of the recurrent unit, the same in every round."""

    keep: Float[Tensor, "batch 96 h w"]
    reset: Float[Tensor, "batch 96 h w"]
    fresh: Float[Tensor, "batch 96 h w"]


class Gru(nn.Module):
    """The convolutional gated recurrent unit, its convolutions split by what they read.

    The context's part is the same in every round, a quarter of the arithmetic. Of the rest, the
    flow's two channels go apart: without them the others are a multiple of 16, which onnxruntime
    has faster convolutions for (a gate of 32 x 32 cells takes 6.4 ms instead of 11.3, all told).
    """

    def __init__(self) -> None:
        super().__init__()
        width = HIDDEN + CONTEXT + MOTION + 2
        self.convz = nn.Conv2d(width, HIDDEN, 3, padding=1)
        self.convr = nn.Conv2d(width, HIDDEN, 3, padding=1)
        self.convq = nn.Conv2d(width, HIDDEN, 3, padding=1)

    def gates(self, context: Float[Tensor, "batch 64 h w"]) -> Gates:
        """The context's part of every gate, biases included."""
        convolutions = (self.convz, self.convr, self.convq)
        return Gates(*(F.conv2d(context, parts(c)[1], c.bias, padding=1) for c in convolutions))

    def forward(
        self,
        state: Float[Tensor, "batch 96 h w"],
        gates: Gates,
        motion: Float[Tensor, "batch 80 h w"],
        flow: Float[Tensor, "batch 2 h w"],
    ) -> Float[Tensor, "batch 96 h w"]:
        """The next state."""

        def gate(convolution: nn.Conv2d, state: Tensor, start: Tensor) -> Tensor:
            features, _, of_flow = parts(convolution)
            seen = F.conv2d(torch.cat((state, motion), 1), features, padding=1)
            return seen + F.conv2d(flow, of_flow, padding=1) + start

        keep = gate(self.convz, state, gates.keep).sigmoid()
        reset = gate(self.convr, state, gates.reset).sigmoid()
        fresh = gate(self.convq, reset * state, gates.fresh).tanh()
        return (1 - keep) * state + keep * fresh


def parts(convolution: nn.Conv2d) -> tuple[Tensor, Tensor, Tensor]:
    """A gate's weights for state and motion, for the context, and for the flow."""
    state, context, motion, flow = convolution.weight.split((HIDDEN, CONTEXT, MOTION, 2), dim=1)
    return torch.cat((state, motion), 1), context, flow


class FlowHead(nn.Module):
    """State to a change of the flow."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(HIDDEN, 128, 3, padding=1)
        self.conv2 = nn.Conv2d(128, 2, 3, padding=1)

    def forward(self, state: Tensor) -> Float[Tensor, "batch 2 h w"]:
        """The change, in cells."""
        return self.conv2(F.relu(self.conv1(state)))


class UpdateBlock(nn.Module):
    """One round: look at the correlations, move the flow. Parameter names are RAFT's."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = MotionEncoder()
        self.gru = Gru()
        self.flow_head = FlowHead()

    def forward(
        self, state: Tensor, gates: Gates, costs: Tensor, flow: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The next state and flow."""
        state = self.gru(state, gates, self.encoder(costs, flow), flow.to(state.dtype))
        return state, flow + self.flow_head(state).to(flow.dtype)


class Flow(nn.Module):
    """RAFT-small without its feature encoder, which is the network's stem."""

    def __init__(self, rounds: int) -> None:
        super().__init__()
        self.count = rounds
        self.cnet = PyramidStem(HIDDEN + CONTEXT, normalised=False)
        self.update_block = UpdateBlock()
        last = nn.Conv2d(64, 1, 1)
        self.spread_head = nn.Sequential(nn.Conv2d(HIDDEN, 64, 3, padding=1), nn.ReLU(), last)
        assert last.bias is not None
        nn.init.zeros_(last.weight)
        nn.init.constant_(last.bias, UNTRAINED_SPREAD)

    def context(self, images: Float[Tensor, "batch 3 H W"]) -> Float[Tensor, "batch 160 h w"]:
        """What a picture in [-1, 1] gives to the flow from it: first state, and context."""
        return self.cnet(images).eighth

    def forward(
        self,
        source: Float[Tensor, "batch c h w"],
        target: Float[Tensor, "batch c h w"],
        context: Float[Tensor, "batch 160 h w"],
        guess: Float[Tensor, "batch 2 h w"] | None = None,
    ) -> Flows:
        """Where the source's cells are in the target, sought from a guess on, else from 0."""
        pyramid = correlate(source.float(), target.float())
        state = context[:, :HIDDEN].tanh()
        gates = self.update_block.gru.gates(F.relu(context[:, HIDDEN:]))
        rounds = []

        def step(carry: Carry, _: float | Tensor) -> Carry:
            state, flow = carry
            flow = flow.detach()  # RAFT's gradient does not cross rounds through the flow
            state, flow = self.update_block(state, gates, look_up(pyramid, flow), flow)
            if self.training:
                rounds.append(flow)
            return state, flow

        if guess is None:
            guess = torch.zeros_like(source[:, :2], dtype=torch.float32)
        state, flow = repeat(step, (state, guess), range(self.count))
        spread = self.spread_head(state.detach())[:, 0].float()
        spread = spread.clamp(SPREAD_MIN, SPREAD_MAX)
        return Flows((*rounds[:-1], flow), spread)


def correlate(
    source: Float[Tensor, "batch c h w"], target: Float[Tensor, "batch c h w"]
) -> list[Float[Tensor, "batch cells rows columns"]]:
    """Correlation of every cell with every cell, the target's averaged at four scales."""
    scale = source.shape[1] ** -0.5
    costs = source.flatten(2).transpose(1, 2) @ target.flatten(2) * scale
    pyramid = [costs.unflatten(2, target.shape[-2:])]
    for _ in range(LEVELS - 1):
        # Rounded up, so that no picture is too small for the coarsest level.
        pyramid.append(F.avg_pool2d(pyramid[-1], 2, ceil_mode=True))
    return pyramid


def look_up(
    pyramid: list[Float[Tensor, "batch cells rows columns"]], flow: Float[Tensor, "batch 2 h w"]
) -> Float[Tensor, "batch levels*49 h w"]:
    """Correlations around where each cell is now thought to be, zero outside the picture.

    All samples of a window lie at the same fraction of a cell: one gathered block of whole cells
    serves them all, two interpolations away.
    """
    rows, columns = flow.shape[-2:]
    y = torch.arange(rows, device=flow.device)[:, None]
    x = torch.arange(columns, device=flow.device)
    x, y = (flow[:, 0] + x).flatten(1), (flow[:, 1] + y).flatten(1)
    found = [window(costs, x / 2**level, y / 2**level) for level, costs in enumerate(pyramid)]
    return torch.cat(found, dim=2).transpose(1, 2).unflatten(2, (rows, columns))


def window(
    costs: Float[Tensor, "batch cells rows columns"],
    x: Float[Tensor, "batch cells"],
    y: Float[Tensor, "batch cells"],
) -> Float[Tensor, "batch cells 49"]:
    """One level's samples; the window's first axis moves along x (the published order)."""
    reach = torch.arange(-RADIUS, RADIUS + 2, device=costs.device)
    # Counted rather than given: in a traced graph the level's size is not known.
    height, width = (torch.ones_like(t).sum() for t in (costs[0, 0, :, 0], costs[0, 0, 0]))
    column, row = x.floor()[..., None] + reach, y.floor()[..., None] + reach
    inside_x = ((column >= 0) & (column < width)).to(costs.dtype)
    inside_y = ((row >= 0) & (row < height)).to(costs.dtype)
    column = column.clamp_min(0).minimum(width - 1)
    row = row.clamp_min(0).minimum(height - 1)
    index = (row[..., None, :] * width + column[..., :, None]).long()
    block = costs.flatten(2).gather(2, index.flatten(2)).unflatten(2, (WINDOW + 1, WINDOW + 1))
    block = block * inside_y[..., None, :] * inside_x[..., :, None]
    fx, fy = (x - x.floor())[..., None, None], (y - y.floor())[..., None, None]
    block = block[..., :-1, :] * (1 - fx) + block[..., 1:, :] * fx
    block = block[..., :-1] * (1 - fy) + block[..., 1:] * fy
    return block.flatten(2)
