"""Matches moved to where pictures agree: known shifts of known patterns."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.ndimage import uniform_filter
from torch import Tensor
from torch.nn import functional as F

from styl3r_export.model.flow import Flows
from styl3r_export.model.subpixel import CELL, LONGEST_WAY, around, settle, traceable

SIDE = 128
CELLS = SIDE // CELL
# Cells whose windows reach neither the border nor what moved across it.
INNER = slice(2, -2)


def pattern(x: np.ndarray, y: np.ndarray, seed: int = 0) -> np.ndarray:
    """Smooth colours (3, ...) at pixel coordinates: waves of 6 to 20 pixels in all directions."""
    random = np.random.default_rng(seed)
    total = np.zeros((3, *x.shape))
    for _ in range(24):
        length, angle, phase = 6 + 14 * random.random(), *(2 * np.pi * random.random(2))
        along = (x * np.cos(angle) + y * np.sin(angle)) * 2 * np.pi / length
        total += random.standard_normal(3)[:, None, None] * np.sin(along + phase)
    return 0.5 + 0.06 * total


def moved_pair(matrix: np.ndarray, shift: np.ndarray) -> tuple[Tensor, Tensor, Tensor]:
    """Two pictures, the second being the first moved affinely, and the true flow in cells."""
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5
    target = np.stack((x, y))
    # What the target shows at a place is the source at the inverse motion of it.
    back = np.linalg.inv(matrix)
    source_x, source_y = np.einsum("ij,jhw->ihw", back, target - shift[:, None, None])
    pair = (pattern(x, y), pattern(source_x, source_y))
    y, x = (np.mgrid[:CELLS, :CELLS] + 0.5) * CELL
    cells = np.stack((x, y))
    there = np.einsum("ij,jhw->ihw", matrix, cells) + shift[:, None, None]
    flow = torch.from_numpy((there - cells) / CELL).float()[None]
    return torch.from_numpy(pair[0]).float()[None], torch.from_numpy(pair[1]).float()[None], flow


def settled(source: Tensor, target: Tensor, start: Tensor) -> Tensor:
    flows = Flows((start,), torch.zeros_like(start[:, 0]))
    return settle(flows, traceable(source), traceable(target)).rounds[-1]


def pixels_off(flow: Tensor, truth: Tensor) -> np.ndarray:
    return (flow - truth)[:, :, INNER, INNER].norm(dim=1).numpy().ravel() * CELL


@pytest.mark.parametrize("gain", [1.0, 0.6])
@pytest.mark.parametrize(
    "matrix", [np.eye(2), np.array([[1.05, 0.06], [-0.06, 1.05]])], ids=["shift", "turn and zoom"]
)
def test_an_error_of_a_pixel_becomes_one_of_a_tenth(matrix: np.ndarray, gain: float) -> None:
    source, target, truth = moved_pair(matrix, np.array([3.3, -2.6]))
    noise = torch.randn(truth.shape, generator=torch.Generator().manual_seed(0))
    # Neighbours share most of their error, as a recurrent flow's do.
    smooth = F.avg_pool2d(noise, 5, 1, 2)
    start = truth + smooth / smooth.std() / CELL
    found = settled(source, target * gain + 0.1, start)
    assert np.median(pixels_off(start, truth)) > 1
    assert np.median(pixels_off(found, truth)) < 0.1
    assert np.quantile(pixels_off(found, truth), 0.9) < 0.25


def test_nothing_to_go_by_leaves_matches_where_they_are() -> None:
    flat = torch.full((1, 3, SIDE, SIDE), 0.4)
    start = torch.randn(1, 2, CELLS, CELLS, generator=torch.Generator().manual_seed(1))
    assert torch.equal(settled(flat, flat, start), start)


def test_pictures_of_different_things_move_no_match_far() -> None:
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5
    one, other = (torch.from_numpy(pattern(x, y, seed)).float()[None] for seed in (1, 2))
    start = torch.zeros(1, 2, CELLS, CELLS)
    found = settled(one, other, start)
    assert bool(torch.isfinite(found).all())
    assert float(found.norm(dim=1).max()) <= LONGEST_WAY


def test_earlier_rounds_and_expected_errors_stay() -> None:
    source, target, truth = moved_pair(np.eye(2), np.array([1.0, 0.0]))
    flows = Flows((truth * 0, truth), torch.rand(1, CELLS, CELLS))
    after = settle(flows, traceable(source), traceable(target))
    assert after.rounds[0] is flows.rounds[0]
    assert torch.equal(after.log_spread, flows.log_spread)


def test_means_are_those_of_the_plain_filter_within_the_picture() -> None:
    values = torch.rand(1, 2, 21, 33, generator=torch.Generator().manual_seed(2))
    plain = uniform_filter(values.double().numpy(), size=(1, 1, 7, 7), mode="nearest")
    assert np.abs(around(values, 3).numpy() - plain)[..., 3:-3, 3:-3].max() < 1e-6
    assert float(around(torch.ones(1, 1, 5, 9), 3).sub(1).abs().max()) < 1e-6
