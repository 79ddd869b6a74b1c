"""The paper's first stage on real videos, which have cameras but no depth (section 3.4)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from styl3r_export.curriculum.data_readers.videos import VideoBatch
from styl3r_export.model import Styl3r
from styl3r_export.splatting.fast import splat

WEIGHTS = {"photometric": 1.0, "perceptual": 0.05}  # published
# View z, in units of the inputs' distance, up to which nothing is drawn: a fifth of the published
# near plane (where its rasteriser culls), for inputs a unit apart.
NEAR = 0.02


class PhotometricStep:
    """Gaussians of the inputs, in their own colours, drawn from where the targets were taken.

    All of the network is trained: the content photo that stands in for a style is one of the
    inputs, at random (paper), and colours are the appearance branch's.
    """

    def __init__(self, perceptual: nn.Module, seed: int = 0) -> None:
        self.perceptual = perceptual
        self.random = torch.Generator().manual_seed(seed)

    def __call__(self, model: Styl3r, batch: VideoBatch) -> dict[str, Tensor]:
        """Weighted losses."""
        images, intrinsics = batch.inputs.images, batch.inputs.intrinsics
        content = model.encode(images, intrinsics)
        geometry = model.decode_structure(content, images, intrinsics).geometry
        chosen = int(torch.randint(images.shape[1], (1,), generator=self.random))
        style = images[:, chosen : chosen + 1]
        if model.config.photo_as_style == "signed":
            style = style * 2 - 1
        whole = style.new_ones(len(images), 1)
        colours = model.decode_appearance(content.tokens, style, whole, images)
        with torch.autocast(images.device.type, enabled=False):
            scenes = [
                [part[scene].flatten(0, 2).float() for part in (*geometry, colours)]
                for scene in range(len(images))
            ]
            drawn = draw_targets(scenes, batch)
            truth = batch.targets.images.flatten(0, 1)
            losses = {
                "photometric": F.mse_loss(drawn, truth),
                "perceptual": self._distance(drawn, truth),
            }
        return {name: WEIGHTS[name] * value for name, value in losses.items()}

    def _distance(self, a: Tensor, b: Tensor) -> Tensor:
        """Mean squared difference of unit-length features, over all four depths.

        LPIPS without its learnt channel weights, which need a download.
        """
        with torch.no_grad():
            want = [F.normalize(f, dim=1) for f in self.perceptual(b)]
        got = [F.normalize(f, dim=1) for f in self.perceptual(a)]
        pairs = zip(got, want, strict=True)
        return torch.stack([(x - y).square().sum(dim=1).mean() for x, y in pairs]).sum()


def draw_targets(
    scenes: list[list[Tensor]], batch: VideoBatch
) -> Float[Tensor, "pictures 3 height width"]:
    """Each scene's Gaussians from each of its target cameras, scene by scene."""
    height, width = batch.targets.images.shape[-2:]
    pixels = torch.tensor([[width], [height], [1.0]])
    frames = []
    for scene, gaussians in enumerate(scenes):
        cameras = zip(batch.targets.extrinsics[scene], batch.targets.intrinsics[scene], strict=True)
        for extrinsics, lens in cameras:
            means, scales, rotations, opacities, colours = gaussians
            frame, _, _ = splat(
                means, scales, rotations, opacities, colours, extrinsics, lens * pixels.to(lens),
                (height, width), near=NEAR, threads=torch.get_num_threads(),
            )  # fmt: skip
            frames.append(frame)
    return torch.stack(frames)
