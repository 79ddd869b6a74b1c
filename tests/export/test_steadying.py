"""Steadying: a painter comes to draw pictures alike wherever its grid of pixels lies."""

from __future__ import annotations

from copy import deepcopy

import pytest
import torch
from blurred_scales import Blur
from torch import Tensor, nn

from styl3r_cli.graphs import BUNDLED
from styl3r_export.curriculum.data import Batch
from styl3r_export.curriculum.steadying import GRID, SteadyStep, draw_moved
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


SHIFTS = [(x, y) for y in range(GRID) for x in range(GRID)]


def test_moving_the_grid_moves_a_weave_and_nothing_else() -> None:
    woven, images = Woven(), batch().scenes.images
    still = draw_moved(woven, images, None, 0, 0)  # type: ignore[arg-type]
    for x, y in SHIFTS:
        drawn = draw_moved(woven, images, None, x, y) - images  # type: ignore[arg-type]
        weave = (still - images).roll((-y, -x), (-2, -1))
        torch.testing.assert_close(drawn, weave)


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


def test_a_painter_comes_to_draw_moved_pictures_alike() -> None:
    model, given = load_graphs(BUNDLED / "mini")[0].train(), batch()
    step = SteadyStep(deepcopy(model.strokes), 0, Blur())
    code = step.before.modulator(step.before.style_encoder(given.styles))

    @torch.no_grad()
    def differing() -> float:
        images = given.scenes.images
        return float(
            torch.stack([draw_moved(model.strokes, images, code, *s) for s in SHIFTS]).std(0).mean()
        )

    start, optimiser = differing(), torch.optim.Adam(model.strokes.parameters(), 3e-4)
    for _ in range(40):
        optimiser.zero_grad()
        torch.stack(list(step(model, given).values())).sum().backward()
        optimiser.step()
    assert differing() < 0.3 * start  # 0.5 without the term that asks for it
