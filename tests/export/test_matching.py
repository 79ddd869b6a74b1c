"""From flows to cameras and depths: a wall and a box seen twice, and what has no answer."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

from styl3r_export.model.bundle import Fit
from styl3r_export.model.flow import Flows
from styl3r_export.model.matching import (
    MOST_LOG_DEPTH,
    StarMatching,
    cell_rays,
    rays_at,
    sides_of,
    to_tokens,
    triangulated,
)
from styl3r_export.model.rotations import rotation_matrix

ROWS, COLUMNS = 16, 20
SURE = -3.0  # log of a twentieth of a cell


def lens(others: int) -> Tensor:
    k = torch.tensor([[0.8, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    return k.expand(1, others + 1, 3, 3)


def depth_of(x: Tensor, y: Tensor) -> Tensor:
    """A sloping wall behind, and a smooth mound before it (first view's rays)."""
    return 1.1 + 0.3 * x - 0.35 * torch.exp(-30 * ((x - 0.1) ** 2 + y**2))


def flows_between(rotation: Tensor, translation: Tensor, spread: float = SURE) -> Flows:
    """Exact flow of the first view's cells; the way back by following it to its fixed point."""
    k = lens(1)
    own = cell_rays(k[0, 0], ROWS, COLUMNS)

    def forth(rays: Tensor) -> Tensor:
        depth = depth_of(rays[:, 0], rays[:, 1])
        points = F.pad(rays, (0, 1), value=1.0) * depth[:, None]
        there = points @ rotation_matrix(rotation).T + translation
        return there[:, :2] / there[:, 2:]

    source = own.clone()
    for _ in range(60):  # the ray of the first view that lands on each of the other's cells
        source = source + (own - forth(source))

    def cells(rays: Tensor) -> Tensor:
        size = torch.tensor([COLUMNS, ROWS])
        return (rays * torch.tensor([0.8, 1.0]) + 0.5) * size - 0.5

    both = torch.stack([cells(forth(own)) - cells(own), cells(source) - cells(own)])
    flow = both.transpose(1, 2).unflatten(2, (ROWS, COLUMNS))
    return Flows((flow,), torch.full((2, ROWS, COLUMNS), spread))


def turn(degrees: float) -> Tensor:
    half = math.radians(degrees) / 2
    return torch.tensor([math.cos(half), 0.1 * math.sin(half), math.sqrt(0.99) * math.sin(half), 0])


@pytest.mark.parametrize(("degrees", "shift"), [(3, 0.08), (12, 0.25), (25, 0.45), (40, 0.7)])
def test_exact_flow_gives_the_camera_and_the_depth(degrees: float, shift: float) -> None:
    rotation = turn(degrees)
    translation = shift * F.normalize(torch.tensor([-1.0, 0.1, 0.15]), dim=0)
    pairs, _, _ = StarMatching.solve(flows_between(rotation, translation), lens(1))
    cosine = (pairs.motion.rotation[0] * rotation).sum().abs().clamp_max(1)
    assert math.degrees(2 * math.acos(float(cosine))) < 0.5
    found = F.normalize(pairs.motion.translation[0], dim=0)
    assert float(found @ F.normalize(translation, dim=0)) > math.cos(math.radians(2))
    rays = cell_rays(lens(1)[0, 0], ROWS, COLUMNS)
    truth = depth_of(rays[:, 0], rays[:, 1]).log()
    seen = pairs.sides.weight[0] > 0.3
    off = (pairs.log_depth[0, 0].flatten() - truth)[seen]
    assert (off - off.median()).abs().median() < 0.02  # up to the one scale that flow leaves open


def test_what_does_not_return_has_little_weight() -> None:
    flows = flows_between(turn(5), torch.tensor([-0.1, 0, 0]))
    broken = flows.rounds[0].clone()
    broken[0, :, 4:8, 4:8] += 3.0
    weight = sides_of(Flows((broken,), flows.log_spread), lens(1))[0].weight[0]
    weight = weight.unflatten(0, (ROWS, COLUMNS))
    assert weight[4:8, 4:8].max() < 0.01
    assert weight[10:14, 8:12].min() > 0.5


def test_matches_outside_the_other_picture_have_no_weight() -> None:
    flows = flows_between(turn(0), torch.tensor([0.0, 0, 0]))
    moved = flows.rounds[0] + torch.tensor([6.0, 0.0])[:, None, None]
    weight = sides_of(Flows((moved,), flows.log_spread), lens(1))[0].weight[0]
    assert (weight.unflatten(0, (ROWS, COLUMNS))[:, -5:] == 0).all()


def test_doubt_lowers_the_weight() -> None:
    sure = sides_of(flows_between(turn(4), torch.tensor([-0.1, 0, 0])), lens(1))[0].weight
    doubt = flows_between(turn(4), torch.tensor([-0.1, 0, 0]), spread=0.0)
    assert (sides_of(doubt, lens(1))[0].weight <= sure).all()


@pytest.mark.parametrize("case", ["still", "noise", "far outside", "one point"])
def test_hopeless_flows_stay_finite(case: str) -> None:
    generator = torch.Generator().manual_seed(1)
    flow = torch.zeros(4, 2, ROWS, COLUMNS)
    if case == "noise":
        flow = 8 * torch.randn(flow.shape, generator=generator)
    elif case == "far outside":
        flow = flow + 500
    elif case == "one point":
        y, x = torch.meshgrid(torch.arange(ROWS), torch.arange(COLUMNS), indexing="ij")
        flow = flow - torch.stack((x - 3.0, y - 5.0))
    flows = Flows((flow,), torch.full((4, ROWS, COLUMNS), SURE))
    pairs, first, rest = StarMatching.solve(flows, lens(2))
    for t in (*pairs.motion, pairs.log_depth, first, rest):
        assert torch.isfinite(t).all()
    assert pairs.log_depth.abs().max() <= MOST_LOG_DEPTH
    if case == "still":
        assert pairs.motion.translation.abs().max() < 1e-4


def test_cells_given_as_places_have_the_cells_rays() -> None:
    k = lens(0)[0]
    y, x = torch.meshgrid(torch.arange(ROWS), torch.arange(COLUMNS), indexing="ij")
    places = torch.stack((x, y), dim=-1)[None].float()
    torch.testing.assert_close(rays_at(places, k), cell_rays(k, ROWS, COLUMNS))


def test_the_first_views_depth_is_the_mean_of_its_pairs_by_worth() -> None:
    generator = torch.Generator().manual_seed(2)
    rho = 0.5 + torch.rand(6, 10, generator=generator)
    information = torch.rand(6, 10, generator=generator)
    found = triangulated(rho, Fit(rho * 0, information), (1, 3))[0]
    want = -(rho[:3].double().log() * information[:3]).sum(0) / information[:3].double().sum(0)
    torch.testing.assert_close(found[0].double(), want, atol=1e-4, rtol=0)
    torch.testing.assert_close(found[1:], -rho[3:].log())


def test_tokens_gather_their_four_cells() -> None:
    cells = torch.arange(2 * 4 * 6 * 3).reshape(1, 2, 24, 3).float()
    tokens = to_tokens(cells, 4, 6)
    grid = cells[0, 1].reshape(4, 6, 3)
    want = torch.cat([grid[2, 4], grid[2, 5], grid[3, 4], grid[3, 5]])
    assert torch.equal(tokens[0, 1, 1 * 3 + 2], want)
