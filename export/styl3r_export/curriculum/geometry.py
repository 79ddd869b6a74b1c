"""Losses of the geometry stage: depth with confidence, cameras, point maps, matches."""

from __future__ import annotations

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from styl3r_export.curriculum.data import Batch
from styl3r_export.model.adapter import Pose, pixel_rays
from styl3r_export.model.flow import Flows
from styl3r_export.model.network import RayDecoding
from styl3r_export.model.rotations import rotate_vectors, rotation_matrix

# Depth beyond this many units says nothing about the scene's shape (sky, distant hills).
FAR = 40.0
# A projected depth this much (relative) behind the depth map is hidden by something.
OCCLUSION = 0.05

# In front of a camera by at least this depth, in units.
NEAR = 1e-3
# Weight of cells that the other view does not see, beside one that it does.
HIDDEN_WEIGHT = 0.2
# Weight of each round's flow beside the next one's (RAFT).
ROUND_DECAY = 0.8
# Under the square root of an error, in cells: a twelfth of a pixel counts as none.
ROOT_FLOOR = 0.01
# Flow errors that the expected error is asked to foresee, in cells, at most.
MOST_CELLS = 12.0
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
    "flow": 0.5,  # root of the end-point error, every round (RAFT's sequence loss)
    "spread": 0.2,  # Laplace likelihood of the flow's expected error
}


class Target(NamedTuple):
    """Where the 1/8 cells of one view move to in another."""

    flow: Float[Tensor, "... 2 h w"]  # in cells
    seen: Bool[Tensor, "... h w"]  # inside the other picture, and not hidden there
    known: Bool[Tensor, "... h w"]  # hidden or a little outside, but the flow can be guessed


def geometry_losses(out: RayDecoding, batch: Batch) -> dict[str, Tensor]:
    """All terms of the stage, unweighted."""
    truth = batch.depth.clamp_max(FAR).log()
    guess = out.decoded.float().log()
    error = (guess - truth).abs()
    log_error = out.log_error.float()
    return {
        "depth": (error * (-log_error).exp() + log_error).mean(),
        "shape": error.mean(),
        "edges": edge_loss(guess - truth),
        **camera_losses(out, batch),
        "points": point_loss(out, batch),
        **flow_losses(out.flows, batch),
    }


def camera_losses(out: RayDecoding, batch: Batch) -> dict[str, Tensor]:
    """Errors of the decoded cameras."""
    rotation, centre = camera_errors(out.guessed, batch)
    return {
        "rotation": rotation.clamp_max(MOST_TURN).mean(),
        "centre": centre.clamp_max(MOST_SHIFT).mean(),
    }


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
    depth = out.decoded.float()[..., 4::8, 4::8]
    truth = batch.depth.clamp_max(FAR)[..., 4::8, 4::8]
    height, width = batch.depth.shape[-2:]
    rays = pixel_rays(batch.intrinsics, height, width)[:, :, 4::8, 4::8]
    guess = rotate_vectors(out.guessed.rotation[:, :, None, None], rays * depth[..., None])
    guess = guess + out.guessed.centre[:, :, None, None]
    world = to_world(rays * truth[..., None], batch.extrinsics)
    return ((guess - world).norm(dim=-1) / truth).clamp_max(3).mean()


def to_world(
    points: Float[Tensor, "batch views h w 3"], extrinsics: Float[Tensor, "batch views 4 4"]
) -> Float[Tensor, "batch views h w 3"]:
    """Points in each view's camera to the world frame."""
    rotation = extrinsics[:, :, None, None, :3, :3]
    moved = points - extrinsics[:, :, None, None, :3, 3]
    return (rotation.transpose(-1, -2) @ moved[..., None]).squeeze(-1)


def flow_targets(batch: Batch) -> Target:
    """True flow of every 1/8 cell, the first view's to all others, behind them theirs back."""
    forth = project_cells(batch, slice(0, 1), slice(1, None))
    back = project_cells(batch, slice(1, None), slice(0, 1))
    flow, seen, known = (
        torch.cat((a.flatten(0, 1), b.flatten(0, 1))) for a, b in zip(forth, back, strict=True)
    )
    return Target(flow, seen, known)


def project_cells(batch: Batch, source: slice, target: slice) -> Target:
    """Where the points on the source views' cells are in the target views."""
    height, width = batch.depth.shape[-2:]
    rays = pixel_rays(batch.intrinsics, height, width)[:, source, 4::8, 4::8]
    points = rays * batch.depth[:, source, 4::8, 4::8, None]
    world = to_world(points, batch.extrinsics[:, source])
    w2c = batch.extrinsics[:, target, None, None]
    seen_at = (w2c[..., :3, :3] @ world[..., None]).squeeze(-1) + w2c[..., :3, 3]
    z = seen_at[..., 2]
    k = batch.intrinsics[:, target, None, None]
    u = seen_at[..., 0] / z.clamp_min(NEAR) * k[..., 0, 0] + k[..., 0, 2]
    v = seen_at[..., 1] / z.clamp_min(NEAR) * k[..., 1, 1] + k[..., 1, 2]
    inside = (z > NEAR) & (u >= 0) & (u < 1) & (v >= 0) & (v < 1)
    pixel_x = (u * width).long().clamp(0, width - 1)
    pixel_y = (v * height).long().clamp(0, height - 1)
    depth = batch.depth[:, target].expand(-1, z.shape[1], -1, -1).flatten(2)
    there = depth.gather(2, (pixel_y * width + pixel_x).flatten(2)).view_as(z)
    visible = inside & (z < there * (1 + OCCLUSION))
    y = (torch.arange(z.shape[-2], device=z.device) * 8 + 4.5)[:, None] / height
    x = (torch.arange(z.shape[-1], device=z.device) * 8 + 4.5) / width
    flow = torch.stack(((u - x) * width / 8, (v - y) * height / 8), dim=2)
    known = (z > NEAR) & ((u - 0.5).abs() < 1) & ((v - 0.5).abs() < 1)
    return Target(flow, visible, known)


def flow_losses(flows: Flows, batch: Batch) -> dict[str, Tensor]:
    """Errors of the flow after every round, and the likelihood of the expected error."""
    target = flow_targets(batch)
    weight = torch.where(target.seen, 1.0, HIDDEN_WEIGHT) * target.known
    total = weight.sum().clamp_min(1)
    loss = flows.log_spread.new_zeros(())
    for age, flow in enumerate(reversed(flows.rounds)):
        error = (flow - target.flow).square().sum(dim=1).add(TINY).sqrt()
        # A square root: matches that are lost altogether must not drown those nearly right.
        loss = loss + ROUND_DECAY**age * ((error + ROOT_FLOOR).sqrt() * weight).sum() / total
    spread = flows.log_spread
    likely = error_of_last(flows, target) * (-spread).exp() + spread
    return {"flow": loss, "spread": (likely * target.known).sum() / target.known.sum().clamp_min(1)}


def error_of_last(flows: Flows, target: Target) -> Tensor:
    """Distance of the final flow from the truth in cells; the flow gets no gradient from it."""
    return (flows.rounds[-1].detach() - target.flow).norm(dim=1).clamp_max(MOST_CELLS)
