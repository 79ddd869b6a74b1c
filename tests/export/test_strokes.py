"""Stroke colours: the published network's numbers, a scene's own colours, a strength dial."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from shared_reference import reference_folder
from torch import Tensor

from styl3r_export.curriculum.teachers import load_npz
from styl3r_export.model.strokes import Code, Enlarge, Strokes, ownness, weighted_mean


def microast() -> Path:
    return reference_folder().parent / "teachers" / "micro-ast"


@pytest.fixture(scope="module")
def network() -> Strokes:
    torch.manual_seed(0)
    return Strokes().eval()


def pictures(count: int, seed: int, side: int = 32) -> Tensor:
    coarse = torch.rand(count, 3, 5, 5, generator=torch.Generator().manual_seed(seed))
    return torch.nn.functional.interpolate(coarse, (side, side), mode="bilinear")


@torch.no_grad()
def test_one_view_in_one_style_is_the_published_picture() -> None:
    network = Strokes().eval()
    network.load_state_dict(load_npz(microast() / "weights.npz"))
    check = np.load(microast() / "check.npz")
    code = network.modulator(network.style_encoder(torch.from_numpy(check["style"]).float()))
    content = network.content_encoder(torch.from_numpy(check["content"]).float())
    drawn = network.decoder(content, code, 1)
    # The published deviation divides by one place fewer.
    assert np.abs(drawn.numpy() - check["stylized"]).max() < 1e-3


def test_smooth_enlarging_repeats_a_seventh_of_what_bilinear_does() -> None:
    wave = torch.sin(torch.arange(32) * torch.pi / 2).expand(1, 1, 32, 32)

    def repeated(smooth: bool) -> float:
        """A wave of 8 pixels in the larger map, and its repetition of 8/3."""
        row = Enlarge(smooth)(wave)[0, 0, 32, 8:-8]
        spectrum = torch.fft.rfft(row - row.mean()).abs()
        return float(spectrum[18] / spectrum[6])

    assert repeated(False) > 0.05
    assert repeated(True) == pytest.approx(repeated(False) * np.tan(np.pi / 8) ** 2, rel=1e-3)


def test_smooth_enlarging_keeps_what_is_even_and_the_middle() -> None:
    torch.testing.assert_close(Enlarge(True)(torch.ones(1, 2, 4, 6)), torch.ones(1, 2, 8, 12))
    dot = torch.zeros(1, 1, 9, 9)
    dot[..., 4, 4] = 1
    large = Enlarge(True)(dot)
    torch.testing.assert_close(large, large.flip(-1))
    torch.testing.assert_close(large, large.flip(-2))
    assert float(large.sum()) == pytest.approx(4, rel=1e-5)


@torch.no_grad()
def test_the_first_view_as_style_gives_the_photos_back(network: Strokes) -> None:
    views = pictures(3, 1)[None]
    colours = network(views, views[:, :1], torch.ones(1, 1))
    torch.testing.assert_close(colours, views, atol=1e-6, rtol=0)


@torch.no_grad()
def test_strength_is_a_straight_way_from_photo_to_painting(network: Strokes) -> None:
    views, style = pictures(2, 1)[None], pictures(1, 2)[None] * 0.3
    style[:, :, 0] += 0.6
    both = torch.cat((style, views[:, :1]), dim=1)
    painted = network(views, both, torch.tensor([[1.0, 0.0]]))
    alone = network(views, style, torch.ones(1, 1))
    torch.testing.assert_close(painted, alone, atol=1e-5, rtol=0)
    half = network(views, both, torch.tensor([[0.5, 0.5]]))
    torch.testing.assert_close(half, (painted + views) / 2, atol=2e-3, rtol=0)


@torch.no_grad()
def test_scenes_of_a_batch_do_not_mix(network: Strokes) -> None:
    views, style = pictures(4, 3).unflatten(0, (2, 2)), pictures(2, 4)[:, None]
    together = network(views, style, torch.ones(2, 1))
    for scene in range(2):
        alone = network(views[scene : scene + 1], style[scene : scene + 1], torch.ones(1, 1))
        torch.testing.assert_close(together[scene : scene + 1], alone, atol=1e-5, rtol=0)


@torch.no_grad()
def test_equal_places_of_two_views_get_equal_colours(network: Strokes) -> None:
    """Statistics over all views together: the same picture twice is drawn the same twice."""
    view = pictures(1, 5)
    other = pictures(1, 6)
    colours = network(torch.cat((view, other, view))[None], pictures(1, 7)[None], torch.ones(1, 1))
    torch.testing.assert_close(colours[0, 0], colours[0, 2], atol=1e-6, rtol=0)


def test_styles_of_no_weight_do_not_count() -> None:
    codes = torch.randn(1, 3, 4, 64)
    mean = weighted_mean(codes, torch.tensor([[0.25, 0.0, 0.75]]))
    torch.testing.assert_close(mean, codes[:, 0] / 4 + codes[:, 2] * 0.75)


def test_ownness_falls_with_distance() -> None:
    code = torch.rand(1, 4, 64) + 0.5
    near, far = code.clone(), code.clone()
    near[:, 0] += 0.02 * code[:, 1]
    far[:, 0] += 2 * code[:, 1]
    styles = torch.stack((code[0], near[0], far[0]))[None]
    same, close, distant = ownness(Code(styles, styles), Code(code, code))[0]
    assert same == 1
    assert 0.9 < close < 1
    assert distant < 1e-6


@torch.no_grad()
def test_black_views_and_flat_styles_stay_finite(network: Strokes) -> None:
    black, white = torch.zeros(1, 2, 3, 16, 16), torch.ones(1, 1, 3, 16, 16)
    assert torch.isfinite(network(black, white, torch.ones(1, 1))).all()
    assert torch.isfinite(network(black, black[:, :1], torch.ones(1, 1))).all()
