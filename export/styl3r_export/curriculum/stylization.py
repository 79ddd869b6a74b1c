"""Losses of the stylization stage (paper section 3.4, stage 2), and a 2D teacher's colours."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F

from styl3r_cli.onnx_library import onnxruntime
from styl3r_export.curriculum.data import Batch
from styl3r_export.curriculum.geometry import OCCLUSION, to_world
from styl3r_export.curriculum.perceptual import STATISTICS_EPS, content_distance, style_distance
from styl3r_export.model import Styl3r
from styl3r_export.model.adapter import pixel_rays

WEIGHTS = {
    "teacher": 8.0,  # mean absolute difference to the 2D teacher's picture
    "style": 10.0,  # the paper's weight; here relative to the style's own statistics
    "content": 5.0,
    "identity": 70.0,  # squared difference, content photo as style (published)
    "agreement": 2.0,  # mean absolute difference of one place's colours between views
}
# Fraction of batches that practise reconstruction, and of those that mix style and content.
IDENTITY_SHARE, MIXED_SHARE = 0.2, 0.15


class StyleBatch(NamedTuple):
    """Scenes, one painting each, and how strongly it applies."""

    scenes: Batch
    styles: Float[Tensor, "batch 3 h w"]
    strength: float  # 1: the painting alone, 0: the scene's own colours


class Paintings(Protocol):
    """Where styles come from: `PictureBank` in memory, `PaintingFolder` on disk."""

    def crops(self, rng: np.random.Generator, count: int, size: int) -> Float[Tensor, "n 3 h w"]:
        """Random paintings in [0, 1]."""


class Teacher:
    """MicroAST (Wang et al., AAAI 2023; MIT) as a graph: a picture in a style, frame by frame."""

    def __init__(self, graph: Path, threads: int) -> None:
        ort = onnxruntime()
        options = ort.SessionOptions()
        options.intra_op_num_threads = threads
        options.log_severity_level = 3
        self.session = ort.InferenceSession(graph, options)

    def __call__(
        self, images: Float[Tensor, "batch views 3 H W"], styles: Float[Tensor, "batch 3 h w"]
    ) -> Float[Tensor, "batch views 3 H W"]:
        """Every view in its scene's style, clipped to [0, 1]."""
        content = images.flatten(0, 1).numpy()
        style = styles.repeat_interleave(images.shape[1], dim=0).numpy()
        feed = {"content": content, "style": style, "alpha": np.ones(1, np.float32)}
        out = torch.from_numpy(self.session.run(None, feed)[0]).clamp(0, 1)
        return out.unflatten(0, images.shape[:2])


class StyleStep:
    """The weighted losses of one batch; only the appearance branch gets gradients."""

    def __init__(self, perceptual: nn.Module, teacher: Teacher | None) -> None:
        self.perceptual = perceptual
        self.teacher = teacher

    def __call__(self, model: Styl3r, batch: StyleBatch) -> dict[str, Tensor]:
        """Losses by name."""
        images = batch.scenes.images
        tokens = None
        if model.config.colours == "tokens":
            with torch.no_grad():
                tokens = model.encode(images, batch.scenes.intrinsics).tokens
        own = images[:, 0]
        if model.config.photo_as_style == "signed":
            own = own * 2 - 1
        if batch.strength == 0:
            colours = stylise(model, tokens, own[:, None], torch.ones(1), images)
            return {"identity": WEIGHTS["identity"] * F.mse_loss(colours, images)}
        styles, weights = batch.styles[:, None], torch.ones(1)
        if batch.strength < 1:
            styles = torch.stack((batch.styles, own), dim=1)
            weights = torch.tensor([batch.strength, 1 - batch.strength])
        colours = stylise(model, tokens, styles, weights, images)
        losses = self._picture_losses(colours, batch)
        losses["agreement"] = view_agreement(colours, batch.scenes)
        return {name: WEIGHTS[name] * value for name, value in losses.items()}

    def _picture_losses(self, colours: Tensor, batch: StyleBatch) -> dict[str, Tensor]:
        images, losses = batch.scenes.images, {}
        if self.teacher is not None:
            target = self.teacher(images, batch.styles)
            target = batch.strength * target + (1 - batch.strength) * images
            losses["teacher"] = (colours - target).abs().mean()
        if batch.strength == 1:
            drawn = [f.float() for f in self.perceptual(colours.flatten(0, 1))]
            with torch.no_grad():
                photo = [f.float() for f in self.perceptual(images.flatten(0, 1))]
                painting = [f.float() for f in self.perceptual(batch.styles)]
            views = images.shape[1]
            painting = [f.repeat_interleave(views, dim=0) for f in painting]
            size = sum(f.square().mean() for f in painting) + STATISTICS_EPS
            losses["style"] = style_distance(drawn, painting) / size
            losses["content"] = content_distance(drawn, photo) / size
        return losses


def stylise(
    model: Styl3r, tokens: Tensor | None, styles: Tensor, weights: Tensor, images: Tensor
) -> Float[Tensor, "batch views 3 H W"]:
    """Colours as pictures."""
    weights = weights.expand(len(images), -1)
    return model.decode_appearance(tokens, styles, weights, images).movedim(-1, 2).float()


def view_agreement(colours: Float[Tensor, "batch views 3 H W"], scenes: Batch) -> Tensor:
    """Mean absolute difference of the first view's colours to what each other view gives them."""
    others, seen = seen_by_others(colours, scenes)
    difference = (others - colours[:, :1]).abs().mean(dim=2, keepdim=True)
    return (difference * seen).sum() / seen.sum().clamp_min(1)


def laid_over(
    colours: Float[Tensor, "batch views 3 H W"], scenes: Batch
) -> Float[Tensor, "batch 3 H W"]:
    """The first view with every place in the mean of its colours in all views that see it."""
    others, seen = seen_by_others(colours, scenes)
    return (colours[:, 0] + (others * seen).sum(dim=1)) / (1 + seen.sum(dim=1))


def seen_by_others(
    colours: Float[Tensor, "batch views 3 H W"], scenes: Batch
) -> tuple[Float[Tensor, "batch others 3 H W"], Bool[Tensor, "batch others 1 H W"]]:
    """What each other view gives the first view's places, and whether it sees them."""
    grid, seen = correspondences(scenes)
    others = F.grid_sample(
        colours[:, 1:].flatten(0, 1), grid.flatten(0, 1), padding_mode="border", align_corners=False
    ).unflatten(0, seen.shape[:2])
    return others, seen[:, :, None]


@torch.no_grad()
def correspondences(
    scenes: Batch,
) -> tuple[Float[Tensor, "batch others H W 2"], Bool[Tensor, "batch others H W"]]:
    """Where the first view's pixels lie in the others ([-1, 1]), and whether they are seen."""
    height, width = scenes.depth.shape[-2:]
    rays = pixel_rays(scenes.intrinsics[:, :1], height, width)
    world = to_world(rays * scenes.depth[:, :1, ..., None], scenes.extrinsics[:, :1])
    w2c = scenes.extrinsics[:, 1:, None, None]
    there = (w2c[..., :3, :3] @ world[..., None]).squeeze(-1) + w2c[..., :3, 3]
    z = there[..., 2].clamp_min(1e-3)
    k = scenes.intrinsics[:, 1:, None, None]
    u = there[..., 0] / z * k[..., 0, 0] + k[..., 0, 2]
    v = there[..., 1] / z * k[..., 1, 1] + k[..., 1, 2]
    grid = torch.stack((u, v), dim=-1) * 2 - 1
    depth = F.grid_sample(
        scenes.depth[:, 1:].flatten(0, 1)[:, None], grid.flatten(0, 1), mode="nearest",
        align_corners=False,
    )  # fmt: skip
    depth = depth.squeeze(1).unflatten(0, z.shape[:2])
    inside = (grid.abs() < 1).all(dim=-1)
    return grid, inside & ((z - depth).abs() < OCCLUSION * z)


def style_batches(
    scenes: Iterator[Batch], flat: Iterator[Batch], styles: Paintings, seed: int,
    *, identity: float = IDENTITY_SHARE, mixed: float = MIXED_SHARE,
) -> Iterator[StyleBatch]:  # fmt: skip
    """Generated scenes and flat photographs in turn, each scene with a painting of its own."""
    rng = np.random.default_rng(seed)
    for source in iter(lambda: scenes if rng.random() < 0.5 else flat, None):
        batch = next(source)
        paintings = styles.crops(rng, len(batch.images), batch.images.shape[-1])
        draw, strength = rng.random(), 1.0
        if draw < identity:
            strength = 0.0
        elif draw < identity + mixed:
            strength = float(rng.uniform(0.1, 0.9))
        yield StyleBatch(batch, paintings, strength)
