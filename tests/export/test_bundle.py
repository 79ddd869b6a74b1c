"""Bundle adjustment on matches: it finds true motions, and stays put without evidence."""

import math

import pytest
import torch
from torch.nn import functional as F

from styl3r_export.model.bundle import Sides, adjust, solve
from styl3r_export.model.matching import COARSE, FINE
from styl3r_export.model.rotations import Motion, multiply_quaternions, rotation_matrix

PAIRS, CELLS = 4, 256
SCHEDULE = COARSE + FINE


def still(pairs: int = PAIRS) -> Motion:
    return Motion(torch.tensor([[1.0, 0, 0, 0]]).repeat(pairs, 1), torch.zeros(pairs, 3))


def turned(degrees: float, axis: torch.Tensor) -> torch.Tensor:
    half = math.radians(degrees) / 2
    return torch.cat((torch.full((len(axis), 1), math.cos(half)), axis * math.sin(half)), -1)


def scene(degrees: float, shift: float) -> tuple[Motion, Sides]:
    """True motions of `degrees` and `shift` units, and perfect matches in both directions."""
    generator = torch.Generator().manual_seed(0)
    axis = F.normalize(torch.randn(PAIRS, 3, generator=generator), dim=-1)
    move = F.normalize(torch.randn(PAIRS, 3, generator=generator), dim=-1) * shift
    motion = Motion(turned(degrees, axis), move)
    rays = F.pad(torch.rand(PAIRS, CELLS, 2, generator=generator) - 0.5, (0, 1), value=1.0)
    rho = 1 / (0.6 + torch.rand(PAIRS, CELLS, generator=generator))
    y = rays @ rotation_matrix(motion.rotation).transpose(-1, -2) + rho[..., None] * move[:, None]
    there = y / y[..., 2:]
    one = torch.ones(2 * PAIRS, CELLS)
    depths = torch.cat((rho, rho / y[..., 2]))
    matched = torch.cat((there[..., :2], rays[..., :2]))
    return motion, Sides(torch.cat((rays, there)), matched, one, depths, one * 100)


def degrees_between(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    inverse = torch.cat((b[:, :1], -b[:, 1:]), dim=-1)
    relative = multiply_quaternions(a, inverse)
    return torch.rad2deg(2 * torch.atan2(relative[:, 1:].norm(dim=-1), relative[:, 0].abs()))


@pytest.mark.parametrize(("degrees", "shift"), [(2, 0.05), (8, 0.2), (15, 0.3)])
def test_true_motion_is_found_from_a_standing_camera(degrees, shift):
    motion, sides = scene(degrees, shift)
    found, _ = adjust(still(), sides, SCHEDULE)
    assert degrees_between(found.rotation, motion.rotation).max() < 0.3
    assert (found.translation - motion.translation).norm(dim=-1).max() < 0.01


def test_outliers_are_discounted():
    motion, sides = scene(6, 0.15)
    generator = torch.Generator().manual_seed(1)
    wrong = torch.rand(2 * PAIRS, CELLS, 1, generator=generator) < 0.3
    noise = torch.rand(2 * PAIRS, CELLS, 2, generator=generator) - 0.5
    sides = sides._replace(matched=torch.where(wrong, noise, sides.matched))
    found, _ = adjust(still(), sides, SCHEDULE)
    assert degrees_between(found.rotation, motion.rotation).max() < 1.0


def test_depths_follow_the_parallax():
    motion, sides = scene(5, 0.3)
    truth = sides.prior
    flat = sides._replace(prior=torch.ones_like(truth), stiffness=torch.full_like(truth, 1e-3))
    _, rho = adjust(motion, flat, SCHEDULE)
    # Up to the one scale that two views leave open, which the guess holds near the truth.
    ratio = rho / truth
    assert (ratio / ratio.median() - 1).abs().median() < 0.02


def test_without_matches_the_guess_stays():
    motion, sides = scene(5, 0.2)
    nothing = sides._replace(weight=torch.zeros_like(sides.weight))
    found, rho = adjust(motion, nothing, SCHEDULE)
    assert torch.allclose(found.rotation, motion.rotation, atol=1e-6)
    assert torch.allclose(found.translation, motion.translation, atol=1e-6)
    assert torch.allclose(rho, sides.prior)


def test_identical_views_give_a_standing_camera_and_finite_gradients():
    _, sides = scene(0, 0.0)
    matched = sides.matched.clone().requires_grad_()
    found, rho = adjust(still(), sides._replace(matched=matched), SCHEDULE)
    assert found.translation.abs().max() < 1e-5
    (found.rotation.sum() + found.translation.sum() + rho.sum()).backward()
    assert torch.isfinite(matched.grad).all()


def test_points_behind_the_camera_do_not_break_it():
    motion, sides = scene(5, 0.2)
    guess = Motion(motion.rotation, torch.tensor([[0.0, 0, -5]]).repeat(PAIRS, 1))
    found, rho = adjust(guess, sides, SCHEDULE)
    assert torch.isfinite(found.translation).all()
    assert torch.isfinite(rho).all()


def test_elimination_solves_like_lapack():
    generator = torch.Generator().manual_seed(2)
    a = torch.randn(5, 6, 6, generator=generator)
    matrix, right = a @ a.transpose(-1, -2) + torch.eye(6), torch.randn(5, 6, generator=generator)
    expected = -torch.linalg.solve(matrix.double(), right.double())
    assert torch.allclose(solve(matrix, right).double(), expected, atol=1e-4)
