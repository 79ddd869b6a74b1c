"""The network's parts and a whole small one, against float64 restatements and published cases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from float64_oracle import Oracle
from shared_reference import arrays
from torch import Tensor

from styl3r_export.model import FULL, Styl3r, build
from styl3r_export.model.adapter import SH_C0, colours_from_sh, exp_points, free_geometry
from styl3r_export.model.backbone import Backbone
from styl3r_export.model.blocks import Rope, grid_positions, rope_table, rotate

# The published network with small dimensions: two heads of 16 channels, every odd size differs.
SMALL = replace(
    FULL,
    name="small",
    head_dim=16,
    encoder_dim=48,
    encoder_depth=2,
    style_depth=3,
    decoder_dim=32,
    decoder_depth=4,
    stylizer_depth=4,
    hooks=(2, 3, 4),
    head_maps=(6, 8, 10, 12),
    head_features=8,
    point_features=6,
)
# Rms and largest difference, relative to a quantity's rms: float32 rounding, and nothing else
# (a quaternion of nearly no length, once normalised, shows the most of it).
FLOAT32_RMS, FLOAT32_MAX = 2e-6, 2e-4


@pytest.fixture(scope="module")
def small() -> Styl3r:
    """Random weights, strong enough that attention selects and every activation bends."""
    torch.manual_seed(1)
    model = build(SMALL)
    with torch.no_grad():
        for name, parameter in model.named_parameters():
            if parameter.dim() == 1:
                centre = 1.0 if "norm" in name and name.endswith("weight") else 0.0
                parameter.copy_(centre + 0.3 * torch.randn_like(parameter))
            else:
                parameter.mul_(2.0)
        for head in (model.downstream_head1, model.downstream_head2):
            head.get_submodule("dpt.head.4").weight.mul_(0.05)  # an exponential follows
    return model


@pytest.fixture(scope="module")
def oracle(small: Styl3r) -> Oracle:
    c = small.config
    depths = (c.encoder_depth, c.style_depth, c.decoder_depth, c.stylizer_depth)
    return Oracle(dict(small.state_dict()), c.head_dim, depths, c.hooks)


def scene(views: int, rows: int, columns: int, seed: int) -> tuple[Tensor, Tensor]:
    """Random pictures, and a different camera for each."""
    g = torch.Generator().manual_seed(seed)
    images = torch.rand(views, 3, 16 * rows, 16 * columns, generator=g)
    k = torch.zeros(views, 3, 3)
    k[:, 0, 0], k[:, 1, 1] = torch.rand(2, views, generator=g) + 0.6
    k[:, :2, 2] = 0.5 + 0.1 * torch.randn(views, 2, generator=g)
    k[:, 2, 2] = 1
    return images, k


def assert_close(ours: Tensor, expected: Tensor) -> None:
    assert ours.shape == expected.shape
    difference = (ours.double() - expected) / expected.square().mean().sqrt()
    assert float(difference.square().mean().sqrt()) < FLOAT32_RMS
    assert float(difference.abs().max()) < FLOAT32_MAX


@pytest.mark.parametrize(
    ("views", "rows", "columns"),
    [(2, 3, 5), (3, 5, 3), (4, 2, 3), (8, 1, 2), (2, 2, 1), (5, 1, 1)],
)
def test_structure_agrees_with_the_float64_oracle(
    small: Styl3r, oracle: Oracle, views: int, rows: int, columns: int
) -> None:
    images, k = scene(views, rows, columns, seed=views)
    with torch.no_grad():
        ours = small.structure(images, k)._asdict()
    for name, expected in oracle.structure(images, k).items():
        assert_close(ours[name], expected)


@pytest.mark.parametrize(
    ("views", "grid", "style_grid", "weights"),
    [
        (2, (3, 5), (2, 2), (1.0,)),
        (3, (5, 3), (1, 4), (0.25, 0.75)),
        (4, (2, 2), (3, 2), (0.5, 0.2, 0.3)),
        (8, (1, 2), (2, 1), (1.5, -0.5)),
    ],
)
def test_colours_agree_with_the_float64_oracle(
    small: Styl3r,
    oracle: Oracle,
    views: int,
    grid: tuple[int, int],
    style_grid: tuple[int, int],
    weights: tuple[float, ...],
) -> None:
    images, k = scene(views, *grid, seed=views)
    # A painting's values lie in [0, 1], those of a photo that stands in for one in [-1, 1].
    styles, _ = scene(len(weights), *style_grid, seed=50)
    styles[-1] = styles[-1] * 2 - 1
    w = torch.tensor(weights)
    with torch.no_grad():
        tokens = small.structure(images, k).content_tokens
        ours = small.appearance(tokens, styles, w, images)
    assert_close(ours, oracle.appearance(images, k, styles, w))


def test_the_oracle_notices_the_common_mistakes(small: Styl3r, oracle: Oracle) -> None:
    """A check of the check: each of these changes is visible at the tolerance used."""
    images, k = scene(3, 3, 2, seed=9)
    with torch.no_grad():
        ours = small.structure(images, k)
    swapped = oracle.structure(images[[1, 0, 2]], k[[1, 0, 2]])
    c = SMALL
    depths = (c.encoder_depth, c.style_depth, c.decoder_depth, c.stylizer_depth)
    torch_eps = Oracle(oracle.w, c.head_dim, depths, c.hooks, eps=1e-5)
    for changed in (
        torch_eps.structure(images, k),
        oracle.structure(images, k * torch.tensor([1.001, 1, 1])[:, None]),
        {n: v[[1, 0, 2]] for n, v in swapped.items()},  # the first view has its own weights
    ):
        with pytest.raises(AssertionError):
            assert_close(ours.means, changed["means"])


def test_views_after_the_first_may_come_in_any_order(small: Styl3r) -> None:
    images, k = scene(4, 2, 3, seed=4)
    order = [0, 3, 1, 2]
    with torch.no_grad():
        plain, moved = small.structure(images, k), small.structure(images[order], k[order])
    for a, b in zip(plain, moved, strict=True):
        assert_close(b, a[order].double())


def test_a_batch_of_scenes_is_each_scene_on_its_own(small: Styl3r) -> None:
    scenes = [scene(3, 2, 3, seed=s) for s in (1, 2)]
    images, k = (torch.stack(part) for part in zip(*scenes, strict=True))
    with torch.no_grad():
        batched = small.decode_structure(small.encode(images, k), images, k).geometry
        for i, (pictures, cameras) in enumerate(scenes):
            alone = small.structure(pictures, cameras)
            for a, b in zip(batched, alone[:4], strict=True):
                assert_close(a[i], b.double())


def test_rotary_embedding_agrees_with_the_published_case() -> None:
    case = arrays("unit_fixtures.npz")
    for tokens, places, expected in zip(
        case["rope/tokens"], case["rope/pos_yx"], case["rope/out"], strict=True
    ):
        rope = rope_table(torch.from_numpy(places), tokens.shape[-1])
        np.testing.assert_allclose(rotate(torch.from_numpy(tokens), rope), expected, atol=2e-6)


def test_rotary_products_depend_on_relative_positions_only() -> None:
    torch.manual_seed(0)
    q, k = torch.randn(2, 1, 64)
    products = []
    for offset in (0, 7):
        places = torch.tensor([[1, 2], [4, 3]]) + offset
        rope = rope_table(places, 64)
        turn = [rotate(x, Rope(rope.cos[i], rope.sin[i])) for i, x in enumerate((q, k))]
        products.append(float((turn[0] * turn[1]).sum()))
    assert products[0] == pytest.approx(products[1], abs=1e-4)


def test_positions_agree_with_the_published_case() -> None:
    expected = arrays("unit_fixtures.npz")["positions/3x4_with_intrinsics"][0]
    ours = grid_positions(3, 4, torch.device("cpu"), camera_token=True)
    assert np.array_equal(ours.numpy(), expected)


def test_points_agree_with_the_published_cases() -> None:
    case = arrays("unit_fixtures.npz")
    ours = exp_points(torch.from_numpy(case["points/raw"])).numpy()
    np.testing.assert_allclose(ours, case["points/out"], rtol=3e-6, atol=1e-12)


def test_gaussians_agree_with_the_published_cases() -> None:
    case = arrays("unit_fixtures.npz")
    raw = torch.from_numpy(case["adapter/raw"]).T[None, None, :, None]  # (1, 1, 11, 1, 512)
    out = free_geometry(torch.zeros(1, 1, 3, 1, 512), raw[:, :, :8])
    xyzw = out.rotations[0, 0, 0][:, [1, 2, 3, 0]]
    np.testing.assert_allclose(xyzw, case["adapter/rotations_xyzw"], atol=2e-7)
    np.testing.assert_allclose(out.scales[0, 0, 0], case["adapter/scales"], rtol=2e-6)
    np.testing.assert_allclose(out.opacities[0, 0, 0], case["adapter/opacities"], atol=2e-7)
    colours = colours_from_sh(raw[:, :, 8:])[0, 0, 0]
    np.testing.assert_allclose((colours - 0.5) / SH_C0, case["adapter/sh_dc"], atol=1e-6)


def test_one_view_alone_is_refused(small: Styl3r) -> None:
    images, k = scene(1, 2, 2, seed=1)
    with pytest.raises(ValueError, match="2 views"):
        small.structure(images, k)


def test_every_parameter_that_should_matters(small: Styl3r) -> None:
    """Only what the published list names as unused gets no gradient."""
    images, k = scene(3, 3, 2, seed=2)
    styles, _ = scene(1, 2, 2, seed=3)
    small.zero_grad()
    out = small.structure(images, k)
    colours = small.appearance(out.content_tokens, styles, torch.ones(1), images)
    sum(t.square().sum() for t in (*out, colours)).backward()
    unused = {
        n for n, p in small.named_parameters() if p.grad is None or not p.grad.abs().max() > 0
    }
    small.zero_grad()
    expected = {
        n
        for n, _ in small.named_parameters()
        if n.endswith("mask_token") or "refinenet4.resConfUnit1" in n
    }
    assert unused == expected


def test_the_backbone_has_no_state_but_its_parameters() -> None:
    with torch.device("meta"):
        assert not list(Backbone(FULL).buffers())
