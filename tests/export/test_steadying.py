"""Steadying: what hangs on the grid of pixels is gone from what the painter learns."""

from __future__ import annotations

from copy import deepcopy

import pytest
import torch
from blurred_scales import Blur
from torch import Tensor, nn

from styl3r_cli.graphs import BUNDLED
from styl3r_export.curriculum.data import Batch
from styl3r_export.curriculum.steadying import GRID, SteadyStep, draw
from styl3r_export.curriculum.stylization import StyleBatch
from styl3r_export.graphs_reading import load_graphs

SIDE = 32


class Woven(nn.Module):
    """A painter that puts the same weave on every picture, wherever the picture is shifted to."""

    def __init__(self) -> None:
        super().__init__()
        self.rows, self.columns = torch.rand(2, 3, GRID)
        self.modulator = self.style_encoder = self.content_encoder = nn.Identity()

    def decoder(self, pictures: Tensor, _code: object, _views: int) -> Tensor:
        """The pictures, and the weave over them."""
        height, width = (size // GRID for size in pictures.shape[-2:])
        across, down = self.rows.repeat(1, width), self.columns.repeat(1, height)
        return pictures + across[:, None, :] + down[:, :, None]


def batch() -> StyleBatch:
    """Two views of a plane without motion, and a painting."""
    torch.manual_seed(0)
    images = torch.rand(1, 1, 3, SIDE, SIDE).expand(-1, 2, -1, -1, -1)
    still = torch.eye(4).repeat(1, 2, 1, 1)
    lens = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]]).repeat(1, 2, 1, 1)
    scene = Batch(images, torch.ones(1, 2, SIDE, SIDE), still, lens)
    return StyleBatch(scene, torch.rand(1, 3, SIDE, SIDE), 1.0)


def test_the_mean_of_shifts_has_no_weave() -> None:
    woven, images = Woven(), batch().scenes.images
    for seed in range(3):
        mean = SteadyStep(woven, seed).mean_of_shifts(images, None)  # type: ignore[arg-type]
        flat = (woven.rows.mean(dim=1) + woven.columns.mean(dim=1))[:, None, None]
        torch.testing.assert_close(mean, images + flat)


def test_strokes_that_cancel_between_views_do_not_count_as_texture() -> None:
    """A painting of flecks: views that agree on them are like it, views that differ are not."""
    given, step = batch(), SteadyStep(Woven(), 0, Blur())  # type: ignore[arg-type]
    given = given._replace(styles=torch.rand(1, 3, SIDE, SIDE).round())
    flecks = torch.rand(1, 1, 3, SIDE, SIDE).round()
    agreeing, differing = flecks.expand(-1, 2, -1, -1, -1), torch.cat((flecks, 1 - flecks), dim=1)
    near, far = (float(step.style(drawn, given)) for drawn in (agreeing, differing))
    assert near < 0.01 < 0.1 < far
    soft = torch.full_like(agreeing, 0.5)
    assert far == pytest.approx(float(step.style(soft, given)))


def test_a_painter_comes_nearer_to_the_mean_over_all_sixteen_shifts() -> None:
    model, given = load_graphs(BUNDLED / "mini")[0].train(), batch()
    step = SteadyStep(deepcopy(model.strokes), seed=0)
    images = given.scenes.images
    with torch.no_grad():
        code = step.before.modulator(step.before.style_encoder(given.styles))
        goal = torch.stack([step.mean_of_shifts(images, code) for _ in range(16)]).mean(dim=0)

    def far() -> float:
        with torch.no_grad():
            return float((draw(model.strokes, images, code) - goal).abs().mean())

    start, optimiser = far(), torch.optim.Adam(model.strokes.parameters(), 3e-4)
    for _ in range(40):
        optimiser.zero_grad()
        torch.stack(list(step(model, given).values())).sum().backward()
        optimiser.step()
    assert far() < 0.7 * start
