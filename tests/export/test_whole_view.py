"""First guesses of flows: pictures that moved far, in parts, not at all, or have nothing alike."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from styl3r_export.model.whole_view import first_guess

SIZE, CHANNELS = 32, 64
STRENGTH = 3.0  # of features: a cell is far more like itself than like any other


def features(rows: int, columns: int) -> Tensor:
    return STRENGTH * torch.randn(1, CHANNELS, rows, columns, generator=torch.manual_seed(0))


@pytest.mark.parametrize("shift", [(0, 0), (4, 0), (-12, 6), (16, -16)])
def test_a_shift_of_up_to_half_the_picture_is_found_at_once(shift: tuple[int, int]) -> None:
    x, y = shift
    world = features(3 * SIZE, 3 * SIZE)
    source = world[..., SIZE : 2 * SIZE, SIZE : 2 * SIZE]
    target = world[..., SIZE - y : 2 * SIZE - y, SIZE - x : 2 * SIZE - x]
    guess = first_guess(source, target)[0]
    at = torch.arange(SIZE)
    inside_x = (at + x >= 4) & (at + x < SIZE - 4)
    inside_y = (at + y >= 4) & (at + y < SIZE - 4)
    off = (guess - torch.tensor([x, y])[:, None, None]).abs()[:, inside_y][:, :, inside_x]
    assert off.max() < 1


def test_an_odd_shift_is_found_to_a_coarse_cell() -> None:
    world = features(SIZE, SIZE + 5)
    guess = first_guess(world[..., 5:], world[..., :-5])[0]
    assert (guess[0, :, 4:-10] - 5).abs().max() < 2
    assert guess[1, :, 4:-10].abs().max() < 1


def test_parts_move_apart() -> None:
    source = features(SIZE, SIZE)
    target = torch.cat((source[..., :16].roll(4, 2), source[..., 16:].roll(-6, 2)), dim=-1)
    guess = first_guess(source, target)[0, 1]
    assert (guess[8:-8, 2:12] - 4).abs().max() < 1
    assert (guess[8:-8, 20:-2] + 6).abs().max() < 1


def test_a_single_wrong_match_is_outvoted() -> None:
    source = features(SIZE, SIZE)
    target = source.clone()
    target[..., 2:6, 2:6], target[..., 20:24, 20:24] = (
        source[..., 20:24, 20:24],
        source[..., 2:6, 2:6],
    )
    assert first_guess(source, target).abs().max() < 2


def test_there_and_back_are_each_others_inverse() -> None:
    world = features(SIZE, SIZE + 8)
    a, b = world[..., 8:], world[..., :-8]
    assert torch.allclose(first_guess(a, b)[0, 0, 4:-4, 6:-14], torch.tensor(8.0), atol=0.5)
    assert torch.allclose(first_guess(b, a)[0, 0, 4:-4, 14:-6], torch.tensor(-8.0), atol=0.5)


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_where_nothing_differs_flows_start_almost_still(value: float) -> None:
    maps = torch.full((1, CHANNELS, SIZE, SIZE), value)
    assert first_guess(maps, maps).abs().max() < SIZE / 8


@pytest.mark.parametrize("strength", [0.0, 1.0, 1e4, 1e15])
def test_pictures_that_share_nothing_lead_to_somewhere_within(strength: float) -> None:
    source = strength * features(SIZE, SIZE)
    guess = first_guess(source, source.flip(1))
    assert torch.isfinite(guess).all()
    assert guess.abs().max() < SIZE


def test_the_smallest_picture_has_a_guess() -> None:
    assert first_guess(*torch.randn(2, 3, 8, 2, 4)).shape == (3, 2, 2, 4)
