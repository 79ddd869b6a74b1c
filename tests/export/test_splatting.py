"""The differentiable renderers: same picture as the command's, and the same gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.splatting import render
from styl3r_export.splatting import fast, reference

SIZE = (29, 37)
BACKGROUND = (0.2, 0.5, 0.8)
NAMES = ("means", "scales", "rotations", "opacities", "colours")


def make_scene(seed: int, count: int = 120, size: float = 0.15) -> list[torch.Tensor]:
    """Random Gaussians around z = 3, some of them behind the camera or outside the frame."""
    random = torch.Generator().manual_seed(seed)
    means = torch.randn(count, 3, generator=random) * 1.3 + torch.tensor([0, 0, 3.0])
    scales = size * torch.exp(torch.randn(count, 3, generator=random))
    rotations = torch.randn(count, 4, generator=random)  # of any length
    opacities = torch.rand(count, generator=random)
    colours = torch.rand(count, 3, generator=random) * 1.2 - 0.1  # a few are negative
    return [means, scales, rotations, opacities, colours]


def make_camera() -> tuple[torch.Tensor, torch.Tensor]:
    axis = torch.tensor([[0, -0.1, 0.05], [0.1, 0, -0.08], [-0.05, 0.08, 0]])
    extrinsics = torch.eye(4)
    extrinsics[:3, :3] = torch.linalg.matrix_exp(axis)
    extrinsics[:3, 3] = torch.tensor([0.1, -0.05, 0.2])
    return extrinsics, torch.tensor([[30.0, 0, 14], [0, 34, 17], [0, 0, 1]])


def gradients(renderer, scene, dtype, near=0.0, **options) -> dict[str, torch.Tensor]:
    """Gradients of one random linear function of colour, alpha and depth."""
    inputs = [value.clone().to(dtype).requires_grad_() for value in scene]
    background = torch.tensor(BACKGROUND, dtype=dtype, requires_grad=True)
    camera = (value.to(dtype) for value in make_camera())
    pictures = renderer(*inputs, *camera, SIZE, background, near=near, **options)
    random = torch.Generator().manual_seed(99)
    loss = sum(
        (picture * torch.randn(picture.shape, generator=random)).sum() for picture in pictures
    )
    loss.backward()
    return dict(zip((*NAMES, "background"), (v.grad for v in (*inputs, background)), strict=True))


@pytest.mark.parametrize("seed", range(3))
def test_the_reference_draws_what_the_command_draws(seed):
    scene = make_scene(seed)
    extrinsics, intrinsics = make_camera()
    camera = Camera(extrinsics.double().numpy(), 30, 34, 14, 17, SIZE[1], SIZE[0])
    frame = render(Gaussians(*(value.numpy() for value in scene)), camera, BACKGROUND, near=0.05)
    inputs = [value.double() for value in (*scene, extrinsics, intrinsics)]
    colour, alpha, depth = reference.splat(*inputs, SIZE, BACKGROUND, near=0.05)
    errors = np.abs(colour.permute(1, 2, 0).numpy() - frame.colour).max(-1)
    assert np.median(errors) < 1e-6
    # A pixel at a threshold may take or leave one splat of alpha 1/255.
    assert (errors > 1e-4).mean() < 0.01
    assert errors.max() < 2 / 255
    close = errors <= 1e-4
    np.testing.assert_allclose(frame.alpha[close], alpha.numpy()[close], atol=1e-4)
    np.testing.assert_allclose(frame.depth[close], depth.numpy()[close], atol=1e-3)


def test_the_fast_one_draws_exactly_what_the_command_draws():
    scene = make_scene(3)
    extrinsics, intrinsics = make_camera()
    camera = Camera(extrinsics.double().numpy(), 30, 34, 14, 17, SIZE[1], SIZE[0])
    frame = render(Gaussians(*(value.numpy() for value in scene)), camera, BACKGROUND)
    colour, alpha, depth = fast.splat(*scene, extrinsics, intrinsics, SIZE, BACKGROUND)
    np.testing.assert_allclose(colour.permute(1, 2, 0).numpy(), frame.colour, atol=1e-6)
    np.testing.assert_array_equal(alpha.numpy(), frame.alpha)
    np.testing.assert_allclose(depth.numpy(), frame.depth, rtol=1e-6)


@pytest.mark.parametrize("size", [0.02, 0.15, 1.0])
@pytest.mark.parametrize("seed", [4, 5])
def test_fast_gradients_are_autograds(seed, size):
    scene = make_scene(seed, size=size)
    expected = gradients(reference.splat, scene, torch.float64)
    found = gradients(fast.splat, scene, torch.float32)
    for name in expected:
        assert expected[name].abs().max() > (0.1 if name in NAMES else 0), name
        error = (found[name] - expected[name]).abs().max() / expected[name].abs().max()
        assert error < 1e-3, name


def test_reference_gradients_are_differences():
    scene = [value.double() for value in make_scene(6, count=8, size=0.4)]
    camera = [value.double() for value in make_camera()]
    inputs = [value.requires_grad_() for value in scene]

    def picture(*inputs: torch.Tensor) -> torch.Tensor:
        return reference.splat(*inputs, *camera, (4, 5), BACKGROUND)[0]

    assert torch.autograd.gradcheck(picture, inputs, eps=1e-7, atol=1e-4)


def test_opaque_layers_have_gradients_too():
    scene = make_scene(7, count=80, size=0.8)
    scene[3] = torch.full_like(scene[3], 0.98)
    expected = gradients(reference.splat, scene, torch.float64)
    found = gradients(fast.splat, scene, torch.float32)
    for name in expected:
        error = (found[name] - expected[name]).abs().max() / expected[name].abs().max()
        assert error < 5e-3, name


def test_threads_do_not_change_a_bit_of_the_gradients():
    scene = make_scene(8, count=400)
    one = gradients(fast.splat, scene, torch.float32, threads=1)
    many = gradients(fast.splat, scene, torch.float32, threads=5)
    for name in one:
        torch.testing.assert_close(many[name], one[name], rtol=0, atol=0)


def test_invisible_and_invalid_gaussians_get_zero_gradients():
    scene = make_scene(9, count=60)
    scene[0][0] = torch.tensor([0, 0, -5.0])
    scene[0][1] = torch.tensor([100.0, 0, 3])
    scene[1][2, 0] = torch.nan
    scene[3][3] = 0
    found = gradients(fast.splat, scene, torch.float32)
    for name in NAMES:
        assert torch.isfinite(found[name]).all(), name
        assert not found[name][:4].any(), name
        assert found[name][4:].any(), name


def test_a_few_steps_of_descent_find_a_picture():
    extrinsics, intrinsics = make_camera()
    target = fast.splat(*make_scene(10, 60), extrinsics, intrinsics, SIZE)[0]
    inputs = [value.requires_grad_() for value in make_scene(11, 60)]
    optimizer = torch.optim.Adam(inputs, lr=0.02)
    losses = []
    for _ in range(60):
        optimizer.zero_grad()
        picture = fast.splat(*inputs, extrinsics, intrinsics, SIZE)[0]
        loss = (picture - target).square().mean()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.3 * losses[0]


def test_no_gaussians():
    empty = [torch.zeros(0, n).requires_grad_() for n in (3, 3, 4)]
    empty += [torch.zeros(0).requires_grad_(), torch.zeros(0, 3).requires_grad_()]
    colour, alpha, depth = fast.splat(*empty, *make_camera(), SIZE, BACKGROUND)
    assert torch.allclose(colour, torch.tensor(BACKGROUND)[:, None, None].expand_as(colour))
    (colour.sum() + alpha.sum() + depth.sum()).backward()
    assert empty[0].grad is not None
    assert empty[0].grad.shape == (0, 3)
