"""Strokes that do not hang on the grid of pixels: a painter learns to draw moved pictures alike."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from styl3r_export.curriculum.perceptual import relative_style_distance
from styl3r_export.curriculum.stylization import StyleBatch, laid_over, view_agreement
from styl3r_export.model import Styl3r
from styl3r_export.model.strokes import Code, Strokes

# The painter's maps have a quarter of the picture's size: shifted by so many pixels, a picture
# lies on their grid as before.
GRID = 4
WEIGHTS = {
    "steady": 20.0,  # mean absolute difference to what is drawn with the grid moved
    "taught": 8.0,  # the same to what was drawn before, with the grid moved
    "agreement": 2.0,  # mean absolute difference of one place's colours between views
    "style": 6.0,  # of the views laid over each other, relative to the painting's own statistics
}


class SteadyStep:
    """The weighted losses of one batch; only what draws gets gradients, styles keep their codes.

    A painter's maps have a quarter of the picture's size, and their enlarging leaves marks at every
    sample: a picture that is moved by a pixel is drawn otherwise (by 0.05 of the range, rms, with
    MicroAST on real photos), and flat areas carry the grid as a weave. Here the painter learns to
    draw a picture as it draws it when moved, which it does best where its maps are enlarged
    smoothly; and to draw as it did before, over all places of the grid, which have no weave in
    common (cycle spinning: Coifman and Donoho, 1995).

    What they have in common is softer than the painting. So what views' strokes become where they
    lie over each other is to have the painting's statistics: texture comes back as strokes that
    agree between views, for others cancel.
    """

    def __init__(self, before: Strokes, seed: int, perceptual: nn.Module) -> None:
        """Learn from `before`, which stays as it is; the seed is of the shifts that are drawn."""
        self.before = before.eval().requires_grad_(False)
        self.perceptual = perceptual
        self.rng = np.random.default_rng(seed)

    def __call__(self, model: Styl3r, batch: StyleBatch) -> dict[str, Tensor]:
        """Losses by name."""
        # In bfloat16 a painter's pictures are off by half of what is to be learnt.
        with torch.autocast(batch.styles.device.type, enabled=False):
            return self._losses(model, batch)

    def _losses(self, model: Styl3r, batch: StyleBatch) -> dict[str, Tensor]:
        images = batch.scenes.images
        with torch.no_grad():
            code = self.before.modulator(self.before.style_encoder(batch.styles))
            taught = draw_moved(self.before, images, code, *self._shift(0))
        drawn = draw(model.strokes, images, code)
        moved = draw_moved(model.strokes, images, code, *self._shift(1))
        losses = {
            "steady": (drawn - moved).abs().mean(),
            "taught": (drawn - taught).abs().mean(),
            "agreement": view_agreement(drawn, batch.scenes),
            "style": self.style(drawn, batch),
        }
        return {name: WEIGHTS[name] * value for name, value in losses.items()}

    def _shift(self, least: int) -> tuple[int, int]:
        """Any of the grid's places, as columns and rows; its own is the first."""
        row, column = divmod(int(self.rng.integers(least, GRID * GRID)), GRID)
        return column, row

    def style(self, drawn: Float[Tensor, "batch views 3 H W"], batch: StyleBatch) -> Tensor:
        """How far the views, laid over each other, are from the painting's own statistics."""
        seen = self.perceptual(laid_over(drawn, batch.scenes).clamp(0, 1))
        with torch.no_grad():
            painting = self.perceptual(batch.styles)
        return relative_style_distance(seen, painting)


def draw(
    strokes: Strokes, images: Float[Tensor, "batch views 3 H W"], code: Code
) -> Float[Tensor, "batch views 3 H W"]:
    """The views in one style a scene."""
    content = strokes.content_encoder(images.flatten(0, 1))
    return strokes.decoder(content, code, images.shape[1]).float().unflatten(0, images.shape[:2])


def draw_moved(
    strokes: Strokes, images: Float[Tensor, "batch views 3 H W"], code: Code, x: int, y: int
) -> Float[Tensor, "batch views 3 H W"]:
    """The same with the maps' grid moved by x columns and y rows, 0 to GRID - 1."""
    height, width = images.shape[-2:]
    around = (x, GRID - x, y, GRID - y)
    moved = F.pad(images.flatten(0, 1), around, mode="reflect").unflatten(0, images.shape[:2])
    return draw(strokes, moved, code)[..., y : y + height, x : x + width]
