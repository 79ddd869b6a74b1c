"""Losses of the geometry stage: depth with confidence, cameras, point maps, matches."""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional as F

from styl3r_export.curriculum.data import Batch
from styl3r_export.model.adapter import Pose, pixel_rays
from styl3r_export.model.matching import Matches
from styl3r_export.model.network import RayDecoding
from styl3r_export.model.rotations import rotate_vectors, rotation_matrix

# Depth beyond this many units says nothing about the scene's shape (sky, distant hills).
FAR = 40.0
# A projected depth this much (relative) behind the depth map is hidden by something.
OCCLUSION = 0.05

# A camera this wrong (radians, units) has failed: more of it should not outweigh the rest.
MOST_TURN, MOST_SHIFT = 0.6, 1.0
# Keeps a square root's slope finite at zero.
TINY = 1e-10

WEIGHTS = {
    "depth": 1.0,  # Laplace likelihood with predicted error (DUSt3R's confidence, made a density)
    "shape": 1.0,  # plain absolute log error: keeps pulling where the likelihood has given up
    "edges": 0.5,  # gradients of log depth at three scales
    "rotation": 4.0,  # radians
    "centre": 2.0,  # scene units
    "points": 1.0,  # point maps in the first view's frame, relative to depth
    "matches": 0.5,  # InfoNCE at 1/8 (MASt3R)
}


class Target(NamedTuple):
    """Where each 1/8 cell of one view lies in another: its cell there, and whether it is seen."""

    cell: Int[Tensor, "batch others cells"]
    seen: Bool[Tensor, "batch others cells"]


def geometry_losses(out: RayDecoding, batch: Batch) -> dict[str, Tensor]:
    """All terms of the stage, unweighted."""
    truth = batch.depth.clamp_max(FAR).log()
    guess = out.depth.float().log()
    error = (guess - truth).abs()
    log_error = out.log_error.float()
    return {
        "depth": (error * (-log_error).exp() + log_error).mean(),
        "shape": error.mean(),
        "edges": edge_loss(guess - truth),
        **camera_losses(out, batch),
        "points": point_loss(out, batch),
        "matches": match_loss(out.matches, batch)
        if out.matches is not None
        else error.new_zeros(()),
    }


def camera_losses(out: RayDecoding, batch: Batch) -> dict[str, Tensor]:
    """Errors of the cameras at every stage of their making; the last counts in full."""
    total = {"rotation": batch.depth.new_zeros(()), "centre": batch.depth.new_zeros(())}
    for pose, share in ((out.pose, 1.0), (out.guessed, 0.3), (out.suggested, 0.3)):
        rotation, centre = camera_errors(pose, batch)
        total["rotation"] = total["rotation"] + share * rotation.clamp_max(MOST_TURN).mean()
        total["centre"] = total["centre"] + share * centre.clamp_max(MOST_SHIFT).mean()
    return total


def camera_errors(pose: Pose, batch: Batch) -> tuple[Tensor, Tensor]:
    """Rotation angle (radians) and centre distance (units) of every view but the first."""
    rotation = batch.extrinsics[:, 1:, :3, :3].transpose(-1, -2)  # camera-to-world
    centre = -(rotation @ batch.extrinsics[:, 1:, :3, 3:]).squeeze(-1)
    guess = rotation_matrix(pose.rotation[:, 1:])
    chord = ((guess - rotation).flatten(-2).square().sum(dim=-1) + TINY).sqrt()
    # ||R1 - R2|| = 2 sqrt(2) sin(angle / 2): linear in small angles, smooth in large ones.
    return chord / 2**0.5, (pose.centre[:, 1:] - centre).norm(dim=-1)


def edge_loss(residual: Float[Tensor, "batch views H W"]) -> Tensor:
    """Mean gradient of the log-depth residual at three scales (MegaDepth)."""
    total = residual.new_zeros(())
    for _ in range(3):
        dx = (residual[..., :, 1:] - residual[..., :, :-1]).abs().clamp_max(1).mean()
        dy = (residual[..., 1:, :] - residual[..., :-1, :]).abs().clamp_max(1).mean()
        total = total + dx + dy
        residual = F.avg_pool2d(residual, 2)
    return total


def point_loss(out: RayDecoding, batch: Batch) -> Tensor:
    """Distance of predicted to true points of all views, at 1/8 size, relative to their depth."""
    depth = out.depth.float()[..., 4::8, 4::8]
    truth = batch.depth.clamp_max(FAR)[..., 4::8, 4::8]
    height, width = batch.depth.shape[-2:]
    rays = pixel_rays(batch.intrinsics, height, width)[:, :, 4::8, 4::8]
    guess = rotate_vectors(out.pose.rotation[:, :, None, None], rays * depth[..., None])
    guess = guess + out.pose.centre[:, :, None, None]
    world = to_world(rays * truth[..., None], batch.extrinsics)
    return ((guess - world).norm(dim=-1) / truth).clamp_max(3).mean()


def to_world(
    points: Float[Tensor, "batch views h w 3"], extrinsics: Float[Tensor, "batch views 4 4"]
) -> Float[Tensor, "batch views h w 3"]:
    """Points in each view's camera to the world frame."""
    rotation = extrinsics[:, :, None, None, :3, :3]
    moved = points - extrinsics[:, :, None, None, :3, 3]
    return (rotation.transpose(-1, -2) @ moved[..., None]).squeeze(-1)


def cell_targets(batch: Batch, source: slice, target: slice) -> Target:
    """Project each 1/8 cell's centre of the source views into the target views."""
    height, width = batch.depth.shape[-2:]
    rows, columns = height // 8, width // 8
    rays = pixel_rays(batch.intrinsics, height, width)[:, source, 4::8, 4::8]
    points = rays * batch.depth[:, source, 4::8, 4::8, None]
    world = to_world(points, batch.extrinsics[:, source])
    w2c = batch.extrinsics[:, target, None, None]
    seen_at = (w2c[..., :3, :3] @ world[..., None]).squeeze(-1) + w2c[..., :3, 3]
    z = seen_at[..., 2]
    k = batch.intrinsics[:, target, None, None]
    u = seen_at[..., 0] / z.clamp_min(1e-3) * k[..., 0, 0] + k[..., 0, 2]
    v = seen_at[..., 1] / z.clamp_min(1e-3) * k[..., 1, 1] + k[..., 1, 2]
    inside = (z > 1e-3) & (u >= 0) & (u < 1) & (v >= 0) & (v < 1)
    column = (u * columns).long().clamp(0, columns - 1)
    row = (v * rows).long().clamp(0, rows - 1)
    cell = (row * columns + column).flatten(2)
    pixel_x = (u * width).long().clamp(0, width - 1)
    pixel_y = (v * height).long().clamp(0, height - 1)
    depth = batch.depth[:, target].expand(-1, z.shape[1], -1, -1).flatten(2)
    there = depth.gather(2, (pixel_y * width + pixel_x).flatten(2))
    visible = z.flatten(2) < there * (1 + OCCLUSION)
    return Target(cell, inside.flatten(2) & visible)


def match_loss(matches: Matches, batch: Batch) -> Tensor:
    """Cross-entropy of each visible cell's match, both directions."""
    there = cell_targets(batch, slice(0, 1), slice(1, None))
    back = cell_targets(batch, slice(1, None), slice(0, 1))
    total = matches.forward.new_zeros(())
    for log_probability, target in (
        (matches.forward, there),
        (matches.backward.transpose(-1, -2), back),
    ):
        picked = log_probability.gather(-1, target.cell[..., None]).squeeze(-1)
        seen = target.seen.float()
        total = total - (picked * seen).sum() / seen.sum().clamp_min(1)
    return total / 2
