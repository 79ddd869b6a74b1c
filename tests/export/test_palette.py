"""Palette transfer: colour statistics arrive as asked, and the identity is exact."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from styl3r_export.model.palette import transfer_palette


def pictures(seed: int, *shape: int) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).random(shape, np.float32)) * 0.6 + 0.2


def test_mean_and_covariance_are_the_styles():
    views, style = pictures(0, 1, 3, 3, 24, 24), pictures(1, 1, 1, 3, 16, 16) ** 2
    moved = transfer_palette(views, style, torch.ones(1, 1)).transpose(1, 2).flatten(2)[0]
    want = style[0, 0].flatten(1)
    assert torch.allclose(moved.mean(1), want.mean(1), atol=1e-5)
    # The floor under the variances moves them a little.
    assert torch.allclose(torch.cov(moved), torch.cov(want), atol=2e-3)


def test_one_transform_serves_all_views():
    views, style = pictures(0, 1, 2, 3, 8, 8), pictures(1, 1, 1, 3, 8, 8)
    views[0, 1, :, 0, 0] = views[0, 0, :, 3, 3]
    moved = transfer_palette(views, style, torch.ones(1, 1))
    assert torch.allclose(moved[0, 1, :, 0, 0], moved[0, 0, :, 3, 3], atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000))
def test_own_palette_is_the_identity(seed):
    views = pictures(seed, 1, 1, 3, 8, 8)
    moved = transfer_palette(views, views, torch.ones(1, 1))
    assert torch.allclose(moved, views, atol=1e-4)


def test_constant_pictures_stay_finite():
    black, white = torch.zeros(1, 2, 3, 8, 8), torch.ones(1, 1, 3, 8, 8)
    moved = transfer_palette(black, white, torch.ones(1, 1))
    assert torch.allclose(moved, torch.ones_like(moved), atol=1e-4)
