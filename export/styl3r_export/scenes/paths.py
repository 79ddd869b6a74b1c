"""Cameras as people move them: sideways steps, walks, arcs, handheld jitter."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.builder import Stage
from styl3r_export.scenes.lighting import look_at

Vector = NDArray[np.float64]

#: Horizontal field of view of a square centre crop, degrees: phones and cameras, few wide ones.
FIELD_OF_VIEW = (34.0, 68.0)
#: First to last camera over the median depth, log-uniform: what casual photos of one thing span.
BASELINE = (0.12, 1.8)
#: Share of the first view's pixels that every other view must see: real pairs that people take
#: share as little, and a network that has never met them finds no camera there.
MIN_OVERLAP = 0.2
#: Points this much deeper than the surface seen there are hidden (relative depth).
HIDDEN = 0.05


def draw_field_of_view(rng: np.random.Generator) -> float:
    """Horizontal angle in radians."""
    low, high = FIELD_OF_VIEW
    return float(np.radians(low + (high - low) * rng.beta(1.6, 1.9)))


def draw_baseline(rng: np.random.Generator) -> float:
    """Length of the movement over the median depth."""
    return float(np.exp(rng.uniform(*np.log(BASELINE))))


def camera_path(
    rng: np.random.Generator,
    stage: Stage,
    depth_ahead: Callable[[Vector, Vector], float],
    baseline: float,
    views: int,
) -> NDArray[np.float64] | None:
    """World-to-camera matrices (V, 4, 4) along one movement, or None if it starts badly.

    Args:
        rng: random source.
        stage: where cameras may be.
        depth_ahead: median scene depth seen from an (eye, target), 0 where a camera is blocked.
        baseline: first to last camera over the median depth.
        views: how many.
    """
    eye, target = stage.viewpoint(rng)
    depth = depth_ahead(eye, target)
    if depth <= 0:
        return None
    toward = (target - eye) / np.linalg.norm(target - eye)
    pivot = eye + toward * depth
    extent = depth * baseline
    eyes = _positions(rng, stage, eye, toward, pivot, extent, views)
    follow = _follow(rng, stage)
    steady, wobble = rng.random() < 0.3, np.radians(rng.uniform(0.3, 3.0))
    tilt = np.radians(rng.normal(0, 2.5))
    if rng.random() < 0.06:  # the camera held upright
        tilt += np.pi / 2 * rng.choice([-1, 1])
    extrinsics = []
    for position in np.clip(eyes, stage.low, stage.high):
        aim = follow * (pivot - position) / depth + (1 - follow) * toward
        aim = aim + rng.normal(0, 0.2 * wobble if steady else wobble, 3)
        roll = tilt + rng.normal(0, 0.3 * wobble if steady else wobble)
        extrinsics.append(look_at(position, position + aim, roll))
    return np.stack(extrinsics)


def _follow(rng: np.random.Generator, stage: Stage) -> float:
    """How far the aim stays on the pivot: 0 looks ahead, 1 keeps it centred, above overturns."""
    if rng.random() < stage.orbit:
        return float(rng.normal(1.05, 0.15))
    return float(rng.choice([0.0, rng.uniform(0, 0.8), rng.uniform(-0.4, 1.6)]))


def _positions(
    rng: np.random.Generator, stage: Stage, eye: Vector, toward: Vector, pivot: Vector,
    extent: float, views: int,
) -> NDArray[np.float64]:  # fmt: skip
    """Where the cameras stand, in order along the movement."""
    steps = np.sort(np.concatenate([[0.0, 1.0], rng.uniform(0, 1, max(views - 2, 0))]))[:views]
    even = np.linspace(0, 1, views)
    steps = even + rng.uniform(0, 0.8) * (steps - even)
    right = np.cross(toward, [0, 0, 1.0])
    right /= max(float(np.linalg.norm(right)), 1e-6)
    up = np.cross(right, toward)
    side = float(rng.choice([-1.0, 1.0]))
    kind = rng.random()
    if kind < 0.2:  # a walk forward or back, drifting
        ahead = side * toward + right * rng.normal(0, 0.25) + up * rng.normal(0, 0.08)
        eyes = eye + steps[:, None] * extent * 0.8 * ahead
    elif kind < 0.2 + 0.5 * stage.orbit + 0.1:  # an arc about the pivot
        arm = eye - pivot
        angles = side * steps * min(extent / float(np.linalg.norm(arm)), 1.6)
        c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
        flat = arm * [1, 1, 0]
        turned = c * flat + s * np.cross([0, 0, 1.0], flat) + arm * [0, 0, 1]
        nearer = 1 + steps[:, None] * rng.normal(0, 0.15)
        lift = steps[:, None] * rng.normal(0, 0.2) * extent * np.array([0, 0, 1.0])
        eyes = pivot + turned * nearer + lift
    elif kind < 0.9:  # sideways steps
        heading = side * right + toward * rng.normal(0, 0.25) + up * rng.normal(0, 0.15)
        eyes = eye + steps[:, None] * extent * heading
    else:  # snapshots around one spot
        eyes = eye + rng.normal(0, 0.4, (views, 3)) * extent * [1, 1, 0.6]
    return eyes + rng.normal(0, 0.02, (views, 3)) * extent


def overlap(
    depths: NDArray[np.float32], extrinsics: NDArray[np.float64], focal: float
) -> NDArray[np.float64]:
    """Share of view 0's pixels that each view sees, by a depth test.

    Args:
        depths: (V, n, n) small depth maps.
        extrinsics: (V, 4, 4) world-to-camera.
        focal: of the small maps, pixels; the principal point is the centre.
    """
    n = depths.shape[-1]
    grid = (np.arange(n) + 0.5 - n / 2) / focal
    rays = np.stack([*np.meshgrid(grid, grid), np.ones((n, n))], -1)
    points = (rays * depths[0][..., None]).reshape(-1, 3)
    seen = []
    for extrinsic, depth in zip(extrinsics, depths, strict=True):
        relative = extrinsic @ np.linalg.inv(extrinsics[0])
        q = points @ relative[:3, :3].T + relative[:3, 3]
        z = np.maximum(q[:, 2], 1e-6)
        u, v = (np.floor(focal * q[:, k] / z + n / 2).astype(int) for k in range(2))
        inside = (q[:, 2] > 0) & (u >= 0) & (u < n) & (v >= 0) & (v < n)
        there = depth[np.clip(v, 0, n - 1), np.clip(u, 0, n - 1)]
        seen.append((inside & (q[:, 2] < there * (1 + HIDDEN))).mean())
    return np.array(seen)
