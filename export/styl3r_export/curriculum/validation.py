"""What a run is measured on while it trains: scenes that it never sees, the same every time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

import torch
from torch import Tensor

from styl3r_export.curriculum.data import Batch
from styl3r_export.curriculum.geometry import FAR, camera_errors
from styl3r_export.model import Styl3r

Step = Callable[[Styl3r, Any], dict[str, Tensor]]
# Batches that a measurement takes: enough to tell a tenth from chance, few beside the training.
BATCHES = 8


class Validation:
    """A stage's losses, and the errors that people ask for, on batches that are kept."""

    def __init__(self, batches: Iterator[Any], step: Step, *, count: int = BATCHES) -> None:
        """Take the first `count` batches."""
        self.batches = list(islice(batches, count))
        self.step = step

    @torch.no_grad()
    def __call__(self, model: Styl3r) -> dict[str, float]:
        """Means over the batches, by name; the model is left as it was."""
        sums: dict[str, list[float]] = {}
        for batch in self.batches:
            found = {name: float(value) for name, value in self.step(model, batch).items()}
            if isinstance(batch, Batch) and model.config.points == "rays":
                found |= geometry_errors(model, batch)
            for name, value in found.items():
                sums.setdefault(name, []).append(value)
        return {name: math.fsum(values) / len(values) for name, values in sums.items()}


@torch.no_grad()
def geometry_errors(model: Styl3r, batch: Batch) -> dict[str, float]:
    """Absolute relative depth error (one scale a scene) and rotation error in degrees, medians.

    Of the depths and cameras that the network gives away: decoded, then pulled to the matches.
    """
    content = model.encode(batch.images, batch.intrinsics)
    rays = model.decode_rays(content, batch.images, batch.intrinsics)
    truth = batch.depth.clamp_max(FAR)
    scale = (truth / rays.depth.float()).flatten(1).median(dim=1).values[:, None, None, None]
    off = (rays.depth.float() * scale - truth).abs() / truth
    chord, _ = camera_errors(rays.pose, batch)
    # The chord is twice the sine of half the angle.
    angle = 2 * torch.asin((chord / 2).clamp(max=1))
    return {
        "AbsRel": float(off.flatten(1).mean(dim=1).median()),
        "rotation (deg)": math.degrees(float(angle.median())),
    }
