"""Cameras and depths pulled together by matches: exact on noise-free ones, still without any."""

from __future__ import annotations

import contextlib
import io
import math
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from styl3r_export.model.bundle import Sides
from styl3r_export.model.matching import cell_rays
from styl3r_export.model.refinement import (
    CELL,
    MAX_CORRECTION,
    OUTLIERS,
    Adjusted,
    adjust_scaled,
    fuse,
    refine,
)
from styl3r_export.model.rotations import Motion, multiply_quaternions, rotation_matrix

INTRINSICS = torch.tensor([[0.9, 0.0, 0.5], [0.0, 0.9, 0.5], [0.0, 0.0, 1.0]])
GRID = 16
# From a standing guess 15 degrees off every true match looks like an outlier at first.
PATIENT = (0.5, 0.3, 0.2, *OUTLIERS)


def turns(pairs: int, degrees: float, generator: torch.Generator) -> Tensor:
    """Rotations by an angle about random axes."""
    axis = F.normalize(torch.randn(pairs, 3, generator=generator), dim=-1)
    half = math.radians(degrees) / 2
    return torch.cat((torch.full((pairs, 1), math.cos(half)), math.sin(half) * axis), dim=-1)


def angles(a: Tensor, b: Tensor) -> Tensor:
    """Degrees between rotations."""
    return torch.rad2deg(2 * (a * b).sum(-1).abs().clamp_max(1).acos())


def seen_from(motion: Motion, points: Tensor) -> Tensor:
    return points @ rotation_matrix(motion.rotation).transpose(-1, -2) + motion.translation[:, None]


def true_sides(motion: Motion, depth: Tensor, stiffness: float) -> Sides:
    """Noise-free matches of points on every cell's ray, weighed where the other view sees them."""
    rays = F.pad(cell_rays(INTRINSICS, GRID, GRID), (0, 1), value=1.0)
    here, there = (rays * d[..., None] for d in depth.chunk(2))
    rotation = rotation_matrix(motion.rotation)
    back = (there - motion.translation[:, None]) @ rotation
    other = torch.cat((seen_from(motion, here), back))
    matched = other[..., :2] / other[..., 2:]
    seen = (matched.abs() < 0.55).all(-1) & (other[..., 2] > 0.1)
    return Sides(
        rays.expand(len(depth), -1, -1), matched, seen.float(), 1 / depth, stiffness * depth**2
    )


@pytest.fixture
def scene() -> tuple[Motion, Tensor, torch.Generator]:
    """True motions of 24 pairs, and depths of both their views' cells (2 * pairs)."""
    generator = torch.Generator().manual_seed(5)
    motion = Motion(turns(24, 8, generator), 0.2 * torch.randn(24, 3, generator=generator))
    depth = torch.randn(48, 1, 4, 4, generator=generator).mul(0.3).exp()
    depth = F.interpolate(depth, size=(GRID, GRID), mode="bilinear").flatten(1)
    return motion, depth, generator


def off_by(motion: Motion, degrees: float, units: float, generator: torch.Generator) -> Motion:
    pairs = len(motion.rotation)
    shift = units * F.normalize(torch.randn(pairs, 3, generator=generator), dim=-1)
    turn = turns(pairs, degrees, generator)
    return Motion(multiply_quaternions(turn, motion.rotation), motion.translation + shift)


def test_true_matches_lead_to_the_true_cameras(
    scene: tuple[Motion, Tensor, torch.Generator],
) -> None:
    motion, depth, generator = scene
    guess = off_by(motion, 15, 0.3, generator)
    found = adjust_scaled(guess, true_sides(motion, depth, 100.0), PATIENT)
    assert angles(found.motion.rotation, motion.rotation).max() < 0.3
    assert (found.motion.translation - motion.translation).norm(dim=-1).max() < 0.01
    assert found.change.abs().median() < 0.005


def test_a_wrong_scale_of_one_view_is_found(scene: tuple[Motion, Tensor, torch.Generator]) -> None:
    motion, depth, generator = scene
    sides = true_sides(motion, depth, 100.0)
    wrong = torch.cat((torch.ones(24), torch.full((24,), 1.25)))[:, None]
    sides = sides._replace(prior=sides.prior / wrong, stiffness=sides.stiffness * wrong**2)
    found = adjust_scaled(off_by(motion, 3, 0.05, generator), sides, PATIENT)
    here, there = (t.median(dim=-1).values for t in found.change.chunk(2))
    assert here.abs().median() < 0.02
    assert (there + math.log(1.25)).abs().median() < 0.02
    assert angles(found.motion.rotation, motion.rotation).median() < 0.1


def test_others_share_one_prior() -> None:
    """Three other views' changes of a cell: the float64 least-squares answer."""
    generator = torch.Generator().manual_seed(3)
    information = 100 * torch.rand(3, 5, generator=generator)
    wanted = 0.1 * torch.randn(3, 5, generator=generator)
    stiffness = (1 + torch.rand(1, 5, generator=generator)).expand(3, -1)
    precision = information + stiffness
    change = wanted * information / precision  # each pair alone, held to the prior
    sides = Sides(*(torch.zeros(()),) * 4, torch.cat((stiffness, stiffness)))
    still = Motion(torch.zeros(3, 4), torch.zeros(3, 3))
    twice = (torch.cat((t, t)) for t in (change, precision))
    fused = fuse(Adjusted(still, *twice), sides, (1, 3))
    rows = torch.cat((information, stiffness[:1])).double().sqrt()
    target = torch.cat((wanted, wanted[:1] * 0)).double() * rows
    for cell in range(5):
        oracle = np.linalg.lstsq(rows[:, cell, None].numpy(), target[:, cell].numpy())[0]
        assert float(fused[0, cell]) == pytest.approx(float(oracle[0]), abs=1e-6)


# ---------------------------------------------------------------------- from matches


def plane_depth(motion: Motion, height: int, width: int) -> Tensor:
    """Depth of the plane z = 1 + 0.3 x - 0.2 y (first view's frame) in a view."""
    normal, distance = torch.tensor([-0.3, 0.2, 1.0]), 1.0
    rotation, translation = rotation_matrix(motion.rotation[0]), motion.translation[0]
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    xy = (torch.stack(((x + 0.5) / width, (y + 0.5) / height), -1) - 0.5) / 0.9
    world = F.pad(xy, (0, 1), value=1.0) @ rotation  # directions
    centre = -(rotation.T @ translation)
    return (distance - centre @ normal) / (world @ normal)


def plane_scene(height: int = 96, width: int = 128) -> tuple[Motion, Tensor, Sides]:
    """One pair: its motion, true depths, and true matches where the other view sees them."""
    still = Motion(torch.tensor([[1.0, 0, 0, 0]]), torch.zeros(1, 3))
    half = math.radians(8) / 2
    motion = Motion(
        torch.tensor([[math.cos(half), 0, math.sin(half), 0]]), torch.tensor([[0.3, 0.05, 0.1]])
    )
    depth = torch.stack([plane_depth(m, height, width) for m in (still, motion)])
    rows, columns = height // CELL, width // CELL
    rays = cell_rays(INTRINSICS, rows, columns)
    here, there = (
        F.pad(rays, (0, 1), value=1.0) * d[3::CELL, 3::CELL].reshape(-1, 1) for d in depth
    )
    there = (there - motion.translation) @ rotation_matrix(motion.rotation[0])
    other = torch.stack((seen_from(motion, here[None])[0], there))
    matched = other[..., :2] / other[..., 2:]
    seen = (matched.abs() < 0.5 / 0.9).all(-1).float()
    own = F.pad(rays, (0, 1), value=1.0).expand(2, -1, -1)
    return motion, depth[None], Sides(own, matched, seen, seen * 0 + 1, seen * 0 + 1)


def plane_gap(motion: Motion, depth: Tensor) -> Tensor:
    """Median distance of the second view's points from the true plane."""
    height, width = depth.shape[-2:]
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    xy = (torch.stack(((x + 0.5) / width, (y + 0.5) / height), -1) - 0.5) / 0.9
    points = F.pad(xy, (0, 1), value=1.0) * depth[0, 1, ..., None]
    world = (points - motion.translation[0]) @ rotation_matrix(motion.rotation[0])
    return (world @ torch.tensor([-0.3, 0.2, 1.0]) - 1).abs().median()


def test_points_of_both_views_meet() -> None:
    motion, depth, matches = plane_scene()
    guess = off_by(motion, 4, 0.08, torch.Generator().manual_seed(2))
    wave = torch.linspace(0, 9, 128).sin() * 0.1
    wrong = depth * torch.stack((torch.zeros(128), wave + 0.2)).exp()[None, :, None]
    found = refine(guess, wrong, torch.full_like(wrong, -2.0), matches)
    # The smooth correction of the depths follows the wave's bends only in part.
    assert plane_gap(found.motion, found.depth) < plane_gap(guess, wrong) / 3
    assert angles(found.motion.rotation, motion.rotation) < 2
    assert found.trust.tolist() == [[1.0, 1.0]]


def test_a_view_that_matches_nowhere_is_not_trusted() -> None:
    motion, depth, matches = plane_scene()
    generator = torch.Generator().manual_seed(6)
    noise = torch.rand(matches.matched.shape, generator=generator) - 0.5
    found = refine(motion, depth, torch.full_like(depth, -2.0), matches._replace(matched=noise))
    assert found.trust[0, 1] < 0.3


def test_without_matches_nothing_moves() -> None:
    motion, depth, matches = plane_scene()
    nothing = matches._replace(weight=matches.weight * 0)
    found = refine(motion, depth, torch.full_like(depth, -2.0), nothing)
    assert found.trust.tolist() == [[1.0, 0.0]]
    torch.testing.assert_close(found.motion.rotation, motion.rotation, rtol=0, atol=1e-6)
    torch.testing.assert_close(found.motion.translation, motion.translation, rtol=0, atol=1e-6)
    torch.testing.assert_close(found.depth, depth, rtol=1e-5, atol=0)


@pytest.mark.parametrize("case", ["same view", "far", "near", "behind", "certain", "collapsed"])
def test_hard_cases_stay_finite_and_bounded(case: str) -> None:
    motion, depth, matches = plane_scene()
    error = torch.full_like(depth, -2.0)
    if case == "same view":  # no baseline: depth is free
        motion = Motion(torch.tensor([[1.0, 0, 0, 0]]), torch.zeros(1, 3))
        matches = matches._replace(matched=matches.rays[..., :2], weight=matches.prior)
        depth = torch.ones_like(depth)
    elif case in ("far", "near"):
        depth = depth * (148 if case == "far" else 0.018)
    elif case == "behind":  # the guess looks the other way
        motion = Motion(torch.tensor([[0.0, 0, 1, 0]]), motion.translation)
    elif case == "certain":
        error = error * 0 - 4
    else:  # every cell matches the same one
        matches = matches._replace(matched=matches.matched * 0 + 0.1)
    inputs = [t.clone().requires_grad_() for t in (*motion, depth, error)]
    found = refine(Motion(inputs[0], inputs[1]), inputs[2], inputs[3], matches)
    change = (found.depth / depth).log().abs().max()
    assert change <= MAX_CORRECTION + 1e-4
    assert all(t.isfinite().all() for t in (*found.motion, found.depth))
    torch.testing.assert_close(found.motion.rotation.norm(dim=-1), torch.ones(1))
    (found.depth.sum() + found.motion.rotation.sum() + found.motion.translation.sum()).backward()
    assert all(t.grad is not None and t.grad.isfinite().all() for t in inputs)


# ---------------------------------------------------------------------- as a graph


class Graph(nn.Module):
    """`refine` for one scene, with plain tensors at its edges."""

    def forward(
        self, rotation: Tensor, translation: Tensor, depth: Tensor, rays: Tensor, matched: Tensor
    ) -> tuple[Tensor, ...]:
        """The refined motions and depths."""
        one = torch.ones_like(matched[..., 0])
        sides = Sides(rays, matched, one, one, one)
        found = refine(Motion(rotation, translation), depth, depth * 0 - 2, sides)
        return (*found.motion, found.depth)


def graph_inputs(others: int, seed: int) -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    motion, depth, matches = plane_scene(64, 96)
    motion = Motion(*(t.expand(others, -1) for t in motion))
    motion = off_by(motion, 2, 0.05, generator)
    rays, matched = (t.repeat_interleave(others, dim=0) for t in matches[:2])
    depth = torch.cat((depth[:, :1], depth[:, 1:].expand(-1, others, -1, -1)), dim=1)
    depth = depth * (1 + 0.1 * torch.rand(depth.shape, generator=generator))
    return dict(zip(("rotation", "translation", "depth", "rays", "matched"),
                    (*motion, depth, rays, matched), strict=True))  # fmt: skip


@pytest.mark.slow
def test_the_graph_agrees_with_torch_for_any_number_of_views(tmp_path: Path) -> None:
    inputs = graph_inputs(4, 0)
    others = torch.export.Dim("others", min=2, max=8)
    dims = {"rotation": {0: others}, "translation": {0: others}, "depth": {1: others + 1},
            "rays": {0: 2 * others}, "matched": {0: 2 * others}}  # fmt: skip
    # The tracer falls back to fixed sizes in silence: other counts of views must run.
    path = tmp_path / "refine.onnx"
    with torch.no_grad(), contextlib.redirect_stdout(io.StringIO()):
        program = torch.onnx.export(
            Graph().eval(),
            kwargs=inputs,
            dynamo=True,
            dynamic_shapes=dims,
            opset_version=20,
            optimize=False,
            verbose=False,
        )
    assert program is not None
    program.save(path)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    for count in (1, 2, 3):
        inputs = graph_inputs(count, count)
        outputs = session.run(None, {k: v.numpy() for k, v in inputs.items()})
        with torch.no_grad():
            wanted = Graph()(**inputs)
        for got, want in zip(outputs, wanted, strict=True):
            np.testing.assert_allclose(got, want.numpy(), atol=1e-4)
