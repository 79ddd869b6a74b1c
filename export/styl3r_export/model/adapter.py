"""From the heads' raw channels to Gaussians (spec section 5), and mini's ray-wise form of it."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional as F

from styl3r_export.model.rotations import Motion, multiply_quaternions, rotate_vectors

# First spherical harmonic: rgb = SH_C0 * coefficient + 0.5.
SH_C0 = 0.28209479177387814
# Published scales: softplus times this, in world units, at most SCALE_MAX.
SCALE_UNIT = 0.001
SCALE_MAX = 0.3
# Keeps the direction of a zero point, and the norm of a zero quaternion, finite (published).
EPS = 1e-8
# Bounds of mini's log depth: 0.02 to 150 times the scene's unit, wider than any scene it can
# tell apart, and far from what the exponential would overflow at.
LOG_DEPTH_MIN, LOG_DEPTH_MAX = -4.0, 5.0
# Bounds of the predicted log error: 1.8 % to 150 %.
LOG_ERROR_MIN, LOG_ERROR_MAX = -4.0, 0.4
# Standard deviations of mini's Gaussians in pixels of the view that made them: what a head can ask
# for at least, and what is made at least. Renderers widen every Gaussian by a constant on the
# screen, so points would do at the photos' size; a frame of more pixels, or a viewer that makes
# small Gaussians as faint as they are, then shows a lattice of dots. Pixels are 1 apart: from 0.5
# on neighbours meet at any size (pixelSplat's least scale, arXiv 2312.12337). Frames of four times
# the photos' size were covered to 79 % with 0.25, to 94 % with 0.4 and to 98 % with 0.5; 0.6 costs
# another 0.2 dB at the photos' own size.
FOOTPRINT_MIN, FOOTPRINT_LEAST = 0.25, 0.5


class Geometry(NamedTuple):
    """Activated geometry of a batch of views, one Gaussian a pixel, world frame."""

    means: Float[Tensor, "batch views H W 3"]
    scales: Float[Tensor, "batch views H W 3"]
    rotations: Float[Tensor, "batch views H W 4"]
    opacities: Float[Tensor, "batch views H W"]


class Pose(NamedTuple):
    """Camera-to-world rotation (unit quaternion w x y z) and camera centre of each view."""

    rotation: Float[Tensor, "batch views 4"]
    centre: Float[Tensor, "batch views 3"]


def exp_points(raw: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """The published points: direction of the raw vector, distance expm1 of its length."""
    length = raw.norm(dim=-1, keepdim=True)
    return raw / length.clamp_min(EPS) * torch.expm1(length)


def free_geometry(
    points: Float[Tensor, "batch views 3 H W"], structure: Float[Tensor, "batch views 8 H W"]
) -> Geometry:
    """The published activations: points in the first view's frame, quaternions turned to wxyz."""
    raw = structure.movedim(2, -1)
    opacity, scale, xyzw = raw.split((1, 3, 4), dim=-1)
    xyzw = xyzw / (xyzw.norm(dim=-1, keepdim=True) + EPS)
    return Geometry(
        means=exp_points(points.movedim(2, -1)),
        scales=(SCALE_UNIT * F.softplus(scale)).clamp_max(SCALE_MAX),
        rotations=torch.cat((xyzw[..., 3:], xyzw[..., :3]), dim=-1),
        opacities=opacity.squeeze(-1).sigmoid(),
    )


def pixel_rays(
    intrinsics: Float[Tensor, "*batch 3 3"], height: int, width: int
) -> Float[Tensor, "*batch H W 3"]:
    """Ray (x/z, y/z, 1) through each pixel's centre, from normalised intrinsics."""
    device = intrinsics.device
    v = ((torch.arange(height, device=device) + 0.5) / height)[:, None]
    u = ((torch.arange(width, device=device) + 0.5) / width)[None, :]
    k = intrinsics[..., None, None, :, :]
    x = (u - k[..., 0, 2]) / k[..., 0, 0] + torch.zeros_like(v)
    y = (v - k[..., 1, 2]) / k[..., 1, 1] + torch.zeros_like(u)
    return torch.stack((x, y, torch.ones_like(x)), dim=-1)


class CameraHead(nn.Module):
    """What the decoder's intrinsics token adds to the motion that the matches suggest."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.hidden = nn.Linear(dim, dim)
        self.out = nn.Linear(dim, 6)  # vector part of a quaternion (w = 1), shift
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, token: Float[Tensor, "batch views dim"], motion: Motion) -> Motion:
        """World-to-camera motions of all views but the first, (batch * others) pairs."""
        raw = self.out(F.gelu(self.hidden(token[:, 1:]))).float().flatten(0, 1)
        turn = torch.cat((torch.ones_like(raw[:, :1]), raw[:, :3]), dim=-1)
        turn = F.normalize(turn, dim=-1)
        rotation = multiply_quaternions(turn, motion.rotation)
        return Motion(rotation, motion.translation + raw[:, 3:])


def pose_of_motion(motion: Motion, batch: int) -> Pose:
    """Camera-to-world poses of all views; the first one is the world."""
    w, axis = motion.rotation[:, :1], motion.rotation[:, 1:]
    rotation = torch.cat((w, -axis), dim=-1)
    centre = -rotate_vectors(rotation, motion.translation)
    rotation, centre = (t.unflatten(0, (batch, -1)) for t in (rotation, centre))
    still = torch.cat((torch.ones_like(centre[:, :1, :1]), torch.zeros_like(centre[:, :1])), dim=-1)
    return Pose(
        torch.cat((still, rotation), dim=1),
        torch.cat((torch.zeros_like(centre[:, :1]), centre), dim=1),
    )


def ray_geometry(
    depth: Float[Tensor, "batch views H W"],
    structure: Float[Tensor, "batch views 8 H W"],
    intrinsics: Float[Tensor, "batch views 3 3"],
    pose: Pose,
) -> Geometry:
    """Points along each pixel's ray, placed by the view's camera; scales in pixel footprints."""
    height, width = depth.shape[-2:]
    raw = structure.movedim(2, -1)
    opacity, scale, xyzw = raw.split((1, 3, 4), dim=-1)
    # The identity is added, so that an untrained head gives round, upright Gaussians.
    local = torch.cat((xyzw[..., 3:] + 1, xyzw[..., :3]), dim=-1)
    turn = pose.rotation[:, :, None, None]
    points = pixel_rays(intrinsics, height, width) * depth[..., None]
    footprint = depth / (intrinsics[..., 0, 0, None, None] * width)
    pixels = (FOOTPRINT_MIN + F.softplus(scale)).clamp_min(FOOTPRINT_LEAST)
    return Geometry(
        means=rotate_vectors(turn, points) + pose.centre[:, :, None, None],
        scales=footprint[..., None] * pixels,
        rotations=multiply_quaternions(turn, F.normalize(local, dim=-1)),
        opacities=opacity.squeeze(-1).sigmoid(),
    )


def seen_from(geometry: Geometry, pose: Pose, view: Int[Tensor, " one"]) -> Geometry:
    """The same Gaussians, one of the views' cameras taken for the world."""
    rotation, centre = (t[:, view, None, None] for t in pose)
    turn = torch.cat((rotation[..., :1], -rotation[..., 1:]), dim=-1)
    return geometry._replace(
        means=rotate_vectors(turn, geometry.means - centre),
        rotations=multiply_quaternions(turn, geometry.rotations),
    )


def log_depth(raw: Float[Tensor, "batch views H W"]) -> Float[Tensor, "batch views H W"]:
    """Softly bounded log depth: the identity near 0, never outside the named bounds."""
    middle = (LOG_DEPTH_MAX + LOG_DEPTH_MIN) / 2
    reach = (LOG_DEPTH_MAX - LOG_DEPTH_MIN) / 2
    return middle + reach * torch.tanh((raw - middle) / reach)


def log_error_of(raw: Float[Tensor, "batch views H W"]) -> Float[Tensor, "batch views H W"]:
    """Bounded log of the depth's expected relative error."""
    return raw.clamp(LOG_ERROR_MIN, LOG_ERROR_MAX)


def colours_from_sh(raw: Float[Tensor, "batch views 3 H W"]) -> Float[Tensor, "batch views H W 3"]:
    """The published colours: degree-0 SH coefficients to sRGB (a renderer clamps them at 0)."""
    return SH_C0 * raw.movedim(2, -1) + 0.5
