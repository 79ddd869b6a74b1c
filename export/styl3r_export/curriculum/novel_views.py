"""Losses of the novel-view stage: Gaussians of two views, rendered from between and from them."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from styl3r_export.curriculum.data import Batch
from styl3r_export.curriculum.geometry import FAR, geometry_losses
from styl3r_export.curriculum.geometry import WEIGHTS as GEOMETRY_WEIGHTS
from styl3r_export.model import Styl3r
from styl3r_export.model.adapter import Geometry, Pose, ray_geometry
from styl3r_export.model.network import to_network
from styl3r_export.splatting.fast import splat

WEIGHTS = {
    "photometric": 20.0,  # squared colour difference; large beside the geometry terms it refines
    "perceptual": 0.05,  # the paper's weight of its perceptual term
}
# The same two terms, an input drawn from its own camera. Without it two views of one surface are
# blended half and half, which is the safest picture from between them and a blurred one of both.
OWN_WEIGHT = 0.5
# Which of the three views is left out, and which go in.
MIDDLE, OUTER = 1, (0, 2)
# Nothing nearer than this fraction of the scene's unit is drawn.
NEAR = 0.02


class NovelViewStep:
    """Three views in walking order: the outer two go in, the middle and one of them are drawn."""

    def __init__(self, perceptual: nn.Module, geometry_too: bool = True, seed: int = 0) -> None:
        """Without `geometry_too` only the Gaussians' other attributes learn: twice as fast."""
        self.perceptual = perceptual
        self.geometry_too = geometry_too
        self.random = torch.Generator().manual_seed(seed)

    def __call__(self, model: Styl3r, batch: Batch) -> dict[str, Tensor]:
        """Weighted losses: the geometry stage's on the two inputs, and the rendered view's."""
        inputs = Batch(*(field[:, ::2] for field in batch))
        with torch.set_grad_enabled(self.geometry_too):
            content = model.encode(inputs.images, inputs.intrinsics)
            rays = model.decode_rays(content, inputs.images, inputs.intrinsics)
        rows, columns = (s // 16 for s in inputs.images.shape[-2:])
        pictures = to_network(inputs.images).flatten(0, 1)
        params = model.gaussian_param_head(rays.hooks, rows, columns, pictures, content.pyramid)
        with torch.autocast("cpu", enabled=False):
            weighted: dict[str, Tensor] = {}
            if self.geometry_too:
                losses = geometry_losses(rays, inputs)
                weighted = {n: GEOMETRY_WEIGHTS[n] * v for n, v in losses.items()}
            params = params.unflatten(0, inputs.images.shape[:2])
            # True cameras and one scale a scene: the Gaussians learn to be seen from between
            # the views without having to make up for a camera that is still being learnt.
            depth = rays.depth * true_scale(rays.depth, inputs.depth)
            geometry = ray_geometry(depth, params, inputs.intrinsics, true_pose(inputs))
            weighted |= self._likeness(geometry, batch, MIDDLE)
            own = OUTER[int(torch.randint(len(OUTER), (), generator=self.random))]
            for name, value in self._likeness(geometry, batch, own).items():
                weighted[f"own {name}"] = OWN_WEIGHT * value
        return weighted

    def _likeness(self, geometry: Geometry, batch: Batch, view: int) -> dict[str, Tensor]:
        """Both weighted terms of one of the three views."""
        rendered, photo = render_view(geometry, batch, view), batch.images[:, view]
        return {
            "photometric": WEIGHTS["photometric"] * F.mse_loss(rendered, photo),
            "perceptual": WEIGHTS["perceptual"] * self._distance(rendered, photo),
        }

    def _distance(self, a: Tensor, b: Tensor) -> Tensor:
        """Mean absolute difference of features at all four depths."""
        with torch.no_grad():
            want = self.perceptual(b)
        pairs = zip(self.perceptual(a), want, strict=True)
        return torch.stack([(x - y).abs().mean() for x, y in pairs]).sum()


@torch.no_grad()
def true_scale(
    depth: Float[Tensor, "batch views H W"], truth: Float[Tensor, "batch views H W"]
) -> Float[Tensor, "batch 1 1 1"]:
    """The one factor that brings a scene's predicted depths to the true ones."""
    ratio = (truth.clamp_max(FAR) / depth).flatten(1).median(dim=1).values
    return ratio[:, None, None, None]


def true_pose(batch: Batch) -> Pose:
    """Camera-to-world poses of a batch's views."""
    rotation = batch.extrinsics[..., :3, :3].transpose(-1, -2)
    centre = -(rotation @ batch.extrinsics[..., :3, 3:]).squeeze(-1)
    return Pose(quaternions(rotation), centre)


def quaternions(rotation: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 4"]:
    """Unit quaternions w x y z of rotation matrices by less than half a turn."""
    w = (1 + rotation.diagonal(dim1=-2, dim2=-1).sum(-1)).clamp_min(1e-6).sqrt() / 2
    r = rotation
    axis = torch.stack(
        (r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]),
        dim=-1,
    )
    return F.normalize(torch.cat((w[..., None], axis / (4 * w[..., None])), dim=-1), dim=-1)


def render_view(geometry: Geometry, batch: Batch, view: int) -> Float[Tensor, "batch 3 H W"]:
    """Each scene's Gaussians in the colours of their own pixels, from one of the three cameras."""
    height, width = batch.images.shape[-2:]
    frames = []
    for scene, extrinsics in enumerate(batch.extrinsics[:, view]):
        means, scales, rotations, opacities = (g[scene].flatten(0, 2) for g in geometry)
        colours = batch.images[scene, ::2].movedim(1, -1).flatten(0, 2)
        lens = batch.intrinsics[scene, view].clone()
        lens[0] *= width
        lens[1] *= height
        colour, _, _ = splat(
            means, scales, rotations, opacities, colours, extrinsics, lens, (height, width),
            near=NEAR, threads=torch.get_num_threads(),
        )  # fmt: skip
        frames.append(colour)
    return torch.stack(frames)
