"""RAFT-small optical flow (Teed and Deng, ECCV 2020), from a plain .npz of its weights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from styl3r_export.curriculum.teachers import load_npz

# The published small network.
ROUNDS = 12  # of its recurrent update
LEVELS, RADIUS = 4, 3  # of the correlation pyramid, and of the look-up in each level
HIDDEN = 96  # channels of the recurrent state; the context's others are inputs
STRIDE = 8  # pixels of one cell
SMALLEST_SIDE = 2 * STRIDE << (LEVELS - 1)  # two cells in the coarsest level


class Raft:
    """Where the pixels of one picture are in another."""

    def __init__(self, weights: Path) -> None:
        """Read the authors' weights, names as in their state dict.

        Raises:
            FileNotFoundError: there is no such file.
        """
        self.weights = load_npz(weights)

    def __call__(self, a: NDArray[np.floating], b: NDArray[np.floating]) -> NDArray[np.float32]:
        """Flow (H, W, 2), x and y in pixels, from picture a to picture b.

        Args:
            a: (H, W, 3) in [0, 1]; sides multiples of 8, at least SMALLEST_SIDE.
            b: of the same shape.
        """
        pair = np.stack([a, b]).clip(0, 1).transpose(0, 3, 1, 2).astype(np.float32)
        with torch.inference_mode():
            coarse = self.coarse_flow(torch.from_numpy(np.ascontiguousarray(pair)) * 2 - 1)
            fine = F.interpolate(
                STRIDE * coarse, scale_factor=STRIDE, mode="bilinear", align_corners=True
            )
        return fine[0].permute(1, 2, 0).numpy()

    def coarse_flow(self, pair: Tensor) -> Tensor:
        """Flow (1, 2, H/8, W/8) in cells, of two pictures (2, 3, H, W) in [-1, 1]."""
        if min(pair.shape[-2:]) < SMALLEST_SIDE or any(s % STRIDE for s in pair.shape[-2:]):
            raise ValueError(f"sides must be multiples of {STRIDE}, at least {SMALLEST_SIDE}")
        maps = self._encode(pair, "fnet", normalised=True)
        pyramid = correlate(maps)
        context = self._encode(pair[:1], "cnet", normalised=False)
        state, inputs = context[:, :HIDDEN].tanh(), context[:, HIDDEN:].relu()
        flow = torch.zeros(1, 2, *maps.shape[-2:])
        for _ in range(ROUNDS):
            state = self._update(state, inputs, look_up(pyramid, flow), flow)
            hidden = self._conv(state, "update_block.flow_head.conv1").relu()
            flow = flow + self._conv(hidden, "update_block.flow_head.conv2")
        return flow

    def _update(self, state: Tensor, inputs: Tensor, costs: Tensor, flow: Tensor) -> Tensor:
        """One round of the recurrent unit."""
        encoder, gru = "update_block.encoder.", "update_block.gru."
        cost = self._conv(costs, encoder + "convc1").relu()
        motion = self._conv(flow, encoder + "convf1").relu()
        motion = self._conv(motion, encoder + "convf2").relu()
        joined = self._conv(torch.cat((cost, motion), 1), encoder + "conv").relu()
        x = torch.cat((inputs, joined, flow), 1)
        both = torch.cat((state, x), 1)
        keep = self._conv(both, gru + "convz").sigmoid()
        reset = self._conv(both, gru + "convr").sigmoid()
        fresh = self._conv(torch.cat((reset * state, x), 1), gru + "convq").tanh()
        return (1 - keep) * state + keep * fresh

    def _encode(self, pictures: Tensor, name: str, normalised: bool) -> Tensor:
        """Maps at 1/8."""

        def norm(x: Tensor) -> Tensor:
            return F.instance_norm(x) if normalised else x

        x = norm(self._conv(pictures, f"{name}.conv1", 2)).relu()
        for layer, stride in ((1, 1), (2, 2), (3, 2)):
            for block, step in ((0, stride), (1, 1)):
                at = f"{name}.layer{layer}.{block}."
                y = norm(self._conv(x, at + "conv1")).relu()
                y = norm(self._conv(y, at + "conv2", step)).relu()
                y = norm(self._conv(y, at + "conv3")).relu()
                if f"{at}downsample.0.weight" in self.weights:
                    x = norm(self._conv(x, at + "downsample.0", step))
                x = (x + y).relu()
        return self._conv(x, f"{name}.conv2")

    def _conv(self, x: Tensor, name: str, stride: int = 1) -> Tensor:
        weight = self.weights[f"{name}.weight"]
        return F.conv2d(x, weight, self.weights[f"{name}.bias"], stride, weight.shape[-1] // 2)


def correlate(maps: Tensor) -> list[Tensor]:
    """All-pairs correlation (cells, 1, h, w) of the first map with the second, at four scales."""
    channels, rows, columns = maps.shape[1:]
    first, second = maps.flatten(2)
    costs = (first.T @ second / channels**0.5).view(rows * columns, 1, rows, columns)
    pyramid = [costs]
    for _ in range(LEVELS - 1):
        pyramid.append(F.avg_pool2d(pyramid[-1], 2))
    return pyramid


def look_up(pyramid: list[Tensor], flow: Tensor) -> Tensor:
    """Correlations around where each cell is now thought to be: (1, levels * 49, h, w)."""
    rows, columns = flow.shape[-2:]
    y, x = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
    here = (torch.stack((x, y)) + flow[0]).permute(1, 2, 0).reshape(-1, 1, 1, 2)
    reach = torch.arange(-RADIUS, RADIUS + 1).float()
    # The first axis of the window moves along x: the published order of the channels.
    window = torch.stack(torch.meshgrid(reach, reach, indexing="ij"), dim=-1)
    found = []
    for level, costs in enumerate(pyramid):
        height, width = costs.shape[-2:]
        at = here / 2**level + window
        grid = 2 * at / torch.tensor([width - 1, height - 1]) - 1
        found.append(F.grid_sample(costs, grid, align_corners=True).flatten(1))
    return torch.cat(found, dim=1).T.view(1, -1, rows, columns)
