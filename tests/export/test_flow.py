"""Matches by recurrent flow: the published network's numbers, and look-ups against a plain one."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from shared_reference import reference_folder
from torch import Tensor

from styl3r_export.evaluate.raft import Raft
from styl3r_export.model.flow import LEVELS, RADIUS, Flow, correlate, look_up


def test_the_published_flow_of_a_shifted_picture() -> None:
    folder = reference_folder().parent / "teachers" / "raft-small"
    check = np.load(folder / "check.npz")
    pair = np.stack([check["image1"], check["image2"]]).transpose(0, 3, 1, 2)
    pair = pair.astype(np.float32)
    if pair.max() > 1:
        pair = pair / 255
    flow = Raft(folder / "weights.npz").coarse_flow(torch.from_numpy(pair) * 2 - 1)
    assert np.abs(flow.numpy() - check["flow_eighth_12iters"]).max() < 2e-3


def plain_look_up(costs: Tensor, x: float, y: float) -> np.ndarray:
    """Bilinear samples of one cell's costs in float64, zero outside, the window's x first."""
    table = costs.double().numpy()
    rows, columns = table.shape

    def at(row: int, column: int) -> float:
        return table[row, column] if 0 <= row < rows and 0 <= column < columns else 0.0

    found = []
    for dx in range(-RADIUS, RADIUS + 1):
        for dy in range(-RADIUS, RADIUS + 1):
            px, py = x + dx, y + dy
            left, top = int(np.floor(px)), int(np.floor(py))
            fx, fy = px - left, py - top
            upper = (1 - fx) * at(top, left) + fx * at(top, left + 1)
            lower = (1 - fx) * at(top + 1, left) + fx * at(top + 1, left + 1)
            found.append((1 - fy) * upper + fy * lower)
    return np.array(found)


@pytest.mark.parametrize("size", [(16, 16), (9, 14)])
def test_look_ups_agree_with_plain_sampling(size: tuple[int, int]) -> None:
    generator = torch.Generator().manual_seed(0)
    source, target = torch.randn(2, 1, 8, *size, generator=generator)
    pyramid = correlate(source, target)
    # Far outside the picture as well: zeros are found there, not the border's values.
    flow = 6 * torch.randn(1, 2, *size, generator=generator)
    flow[0, :, 0, 0] = -40.0
    flow[0, :, -1, -1] = 55.0
    found = look_up(pyramid, flow)[0]
    columns = size[1]
    for cell in (0, 5, columns + 3, size[0] * columns - 1):
        row, column = divmod(cell, columns)
        x, y = column + float(flow[0, 0, row, column]), row + float(flow[0, 1, row, column])
        for level in range(LEVELS):
            want = plain_look_up(pyramid[level][0, cell], x / 2**level, y / 2**level)
            got = found[49 * level : 49 * (level + 1), row, column].numpy()
            np.testing.assert_allclose(got, want, atol=1e-4)


def test_small_pictures_have_every_level() -> None:
    maps = torch.randn(2, 1, 8, 2, 6)
    assert [tuple(p.shape[2:]) for p in correlate(*maps)] == [(2, 6), (1, 3), (1, 2), (1, 1)]


def test_training_sees_every_round_and_inference_the_last() -> None:
    torch.manual_seed(0)
    network = Flow(3)
    maps, context = torch.randn(2, 1, 128, 4, 4), torch.randn(1, 160, 4, 4)
    assert len(network.train()(*maps, context).rounds) == 3
    assert len(network.eval()(*maps, context).rounds) == 1
