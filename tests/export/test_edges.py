"""Depths that jump where pictures do: a board before a wall, seen from two places."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.ndimage import median_filter
from torch import Tensor
from torch.nn import functional as F

from styl3r_cli.cameras.camera import Camera
from styl3r_export.model.bundle import both_ways
from styl3r_export.model.edges import median, seen_at, snap
from styl3r_export.model.rotations import Motion

SIDE = 128
FOCAL = 1.1
WALL, BOARD = 2.0, 1.0
HALF = 0.25  # of the board's width and height, scene units
BASELINE = 0.12
INTRINSICS = torch.tensor([[FOCAL, 0, 0.5], [0, FOCAL, 0.5], [0, 0, 1]])
SIDEWAYS = Motion(torch.tensor([[1.0, 0, 0, 0]]), torch.tensor([[-BASELINE, 0, 0]]))
# Half the width of the slope that a decoder makes of an edge, pixels.
BLUR = 8


def colours(x: np.ndarray, y: np.ndarray, seed: int) -> np.ndarray:
    """Smooth colours of a surface, (3, ...), at scene coordinates."""
    random = np.random.default_rng(seed)
    total = np.zeros((3, *x.shape))
    for _ in range(16):
        frequency = random.uniform(-70, 70, 2)
        total += random.standard_normal(3)[:, None, None] * np.sin(
            frequency[0] * x + frequency[1] * y + random.uniform(0, 6)
        )
    return total * 0.06


def view(shift: float, board: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Colours (3, S, S) and depths (S, S) from a place `shift` to the right."""
    v, u = (np.mgrid[:SIDE, :SIDE] + 0.5) / SIDE - 0.5
    x, y = u / FOCAL, v / FOCAL
    near = (np.abs(x * BOARD + shift) < HALF) & (np.abs(y * BOARD) < HALF) & board
    wall = 0.35 + colours(x * WALL + shift, y * WALL, 1)
    front = 0.65 + colours(x * BOARD + shift, y * BOARD, 2)
    return np.where(near, front, wall), np.where(near, BOARD, WALL)


def scene(board: bool = True) -> tuple[Tensor, Tensor]:
    """Pictures and true depths of both views, as a batch of one."""
    images, depths = zip(*(view(shift, board) for shift in (0.0, BASELINE)), strict=True)
    both = (np.stack(images).clip(0, 1), np.stack(depths))
    pictures, truth = (torch.from_numpy(t.astype(np.float32))[None] for t in both)
    return pictures, truth


def blurred(depth: Tensor) -> Tensor:
    padded = F.pad(depth, (BLUR,) * 4, mode="replicate")
    return F.avg_pool2d(padded, 2 * BLUR + 1, 1)


def lenses(views: int = 2) -> Tensor:
    return INTRINSICS.expand(1, views, 3, 3)


def test_a_blurred_edge_becomes_a_sharp_one_where_it_is() -> None:
    images, truth = scene()
    start = blurred(truth)
    found = snap(start, SIDEWAYS, images, lenses())
    beside = (start - truth).abs() > 0.05
    assert float(beside.float().mean()) > 0.1
    before, after = ((t - truth).abs()[beside] for t in (start, found))
    assert float(after.median()) < 0.15 * float(before.median())
    # What the other view does not see, a sixth of the edge, has nothing to go by.
    assert float(after.mean()) < 0.65 * float(before.mean())
    # And nothing is torn where nothing was wrong.
    assert float(((found - truth).abs()[~beside] > 0.05).float().mean()) < 0.02


def test_a_slanted_wall_stays_as_it_is() -> None:
    images, _ = scene(board=False)
    slope = torch.linspace(1.9, 2.1, SIDE).expand(1, 2, SIDE, SIDE).contiguous()
    found = snap(slope, SIDEWAYS, images, lenses())
    assert float((found / slope - 1).abs().max()) < 0.02


def test_pictures_without_texture_change_nothing() -> None:
    depth = blurred(scene()[1])
    found = snap(depth, SIDEWAYS, torch.full((1, 2, 3, SIDE, SIDE), 0.5), lenses())
    # The last median alone may clip a corner of the slope.
    assert float((found / depth - 1).abs().max()) < 0.03


def test_the_unit_of_length_does_not_matter() -> None:
    images, truth = scene()
    start = blurred(truth)
    far = Motion(SIDEWAYS.rotation, SIDEWAYS.translation * 8)
    found = snap(start * 8, far, images, lenses()) / snap(start, SIDEWAYS, images, lenses())
    assert float((found / 8 - 1).abs().max()) < 1e-4


def test_of_several_views_the_first_hears_all() -> None:
    images, truth = scene()
    three = torch.cat((images, images[:, 1:]), dim=1)
    depth = torch.cat((blurred(truth), blurred(truth)[:, 1:]), dim=1)
    twice = Motion(*(torch.cat((t, t)) for t in SIDEWAYS))
    found = snap(depth, twice, three, lenses(3))
    alone = snap(blurred(truth), SIDEWAYS, images, lenses())
    assert torch.equal(found[:, :2], alone)
    assert torch.equal(found[:, 1], found[:, 2])


def test_projections_are_the_cameras() -> None:
    random = np.random.default_rng(3)
    turn = torch.nn.functional.normalize(torch.tensor([[1.0, 0.05, -0.1, 0.02]]), dim=-1)
    both = both_ways(Motion(turn, torch.tensor([[0.3, -0.1, 0.2]])))
    depth = torch.from_numpy(random.uniform(1, 3, (2, 3, 16, 24)).astype(np.float32))
    lens = torch.tensor([[0.9, 0, 0.52], [0, 1.3, 0.47], [0, 0, 1]]).expand(2, 3, 3)
    other = torch.tensor([[1.1, 0, 0.5], [0, 1.5, 0.55], [0, 0, 1]]).expand(2, 3, 3)
    found = seen_at(depth, both, lens, other).double().numpy()
    for side in range(2):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = both.rotation[side].numpy(), both.translation[side].numpy()
        camera = Camera(pose, 1.1 * 24, 1.5 * 16, 0.5 * 24, 0.55 * 16, 24, 16)
        v, u = np.mgrid[:16, :24] + 0.5
        rays = np.stack(((u / 24 - 0.52) / 0.9, (v / 16 - 0.47) / 1.3, np.ones_like(u)), -1)
        points = rays * depth[side, 1].double().numpy()[..., None]
        local = points @ camera.extrinsics[:3, :3].T + camera.extrinsics[:3, 3]
        uv = local @ camera.intrinsics.T
        wanted = uv[..., :2] / uv[..., 2:] / [24, 16] * 2 - 1
        assert np.abs(found[side, 1] - wanted).max() < 1e-5


@pytest.mark.parametrize("size", [(16, 16), (5, 31)])
def test_the_median_is_that_of_rows_and_then_of_columns(size: tuple[int, int]) -> None:
    x = torch.rand(1, 1, *size, generator=torch.Generator().manual_seed(4))
    rows = median_filter(x.numpy(), size=(1, 1, 3, 1), mode="nearest")
    assert np.array_equal(median(x).numpy(), median_filter(rows, (1, 1, 1, 3), mode="nearest"))
