"""What is known to be true of a scene, and how far a point's result is from it."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.depth_errors import relative_errors, scale_to
from styl3r_cli.cameras.pose_errors import direction_error, motion, rotation_error
from styl3r_cli.cameras.poses import Array
from styl3r_cli.frames import Picture
from styl3r_cli.picture_metrics import psnr, ssim
from styl3r_cli.tradeoff.agreement import unit
from styl3r_cli.tradeoff.perceptual import Perceptual

# Names of the measures, as CSV and JSON have them.
PSNR, SSIM, LPIPS = "truth_psnr", "truth_ssim", "truth_lpips"
ROTATION, DIRECTION = "camera_rotation_degrees", "camera_direction_degrees"
ABSREL, WITHIN = "depth_absrel", "depth_within_25_percent"


class Column(NamedTuple):
    """How tables show measures."""

    names: tuple[str, ...]
    form: str
    meaning: str


COLUMNS = {
    "truth": Column(
        (PSNR,), "{:.1f} dB", "Truth: PSNR from the held-out photos' places, in own colours."
    ),
    "LPIPS": Column((LPIPS,), "{:.3f}", "LPIPS: of the same pictures; 0 is best."),
    "cameras": Column(
        (ROTATION, DIRECTION),
        "{:.2f}, {:.2f}°",
        "Cameras: how far rotations and directions of motion from the first view are off, medians "
        "over the others.",
    ),
    "depth": Column(
        (ABSREL, WITHIN),
        "{:.3f}, {:.0%}",
        "Depth: mean relative error, and the share of pixels within a factor of 1.25, of the "
        "network's depths times one factor for all views; medians over the views.",
    ),
}


@dataclass(frozen=True)
class Truth:
    """What results are compared with; each part is empty where it is not known.

    Attributes:
        pictures: held-out photos.
        perceptual: LPIPS of two pictures, or None.
        cameras: of each photo that was given, in any world.
        depths: by the side of the network's pictures, see `true_depths`.
    """

    pictures: Sequence[Picture] = ()
    perceptual: Perceptual | None = None
    cameras: Sequence[Camera | None] = ()
    depths: Mapping[int, Sequence[Array | None]] = field(default_factory=dict)

    def errors(self, made: Mapping[str, np.ndarray]) -> dict[str, float]:
        """Medians over held-out photos and over views of each measure that can be taken.

        Args:
            made: the arrays that a worker left, poses and pictures among them.
        """
        pairs = [
            (unit(a), unit(b))
            for a, b in zip(made.get("held_out", ()), self.pictures, strict=False)
        ]
        turns = camera_errors(list(made["poses"]), self.cameras)
        depths = self._depth_errors(made["depths"]) if "depths" in made else []
        values = {
            PSNR: [psnr(*pair) for pair in pairs],
            SSIM: [ssim(*pair) for pair in pairs],
            LPIPS: [self.perceptual(*pair) for pair in pairs] if self.perceptual else [],
            ROTATION: [turn for turn, _ in turns],
            DIRECTION: [direction for _, direction in turns],
            ABSREL: [error for error, _ in depths],
            WITHIN: [share for _, share in depths],
        }
        return {name: statistics.median(found) for name, found in values.items() if found}

    def _depth_errors(self, found: np.ndarray) -> list[tuple[float, float]]:
        """Of each view (N, H, W) whose depths are known, after one scale for all of them."""
        truths = self.depths.get(found.shape[1], ())
        pairs = [
            (depths[truth > 0], truth[truth > 0])
            for depths, truth in zip(found, truths, strict=False)
            if truth is not None and truth.any()
        ]
        if not pairs:
            return []
        factor = scale_to(*(np.concatenate(each) for each in zip(*pairs, strict=True)))
        return [relative_errors(factor * depths, truth) for depths, truth in pairs]


def camera_errors(
    found: Sequence[Array], truth: Sequence[Camera | None]
) -> list[tuple[float, float]]:
    """Degrees by which the found motion from the first view to each other one is off.

    Rotation, and direction of translation: how far it goes depends on the unit of length, which
    pictures do not tell. A view whose camera is not known is left out.

    Args:
        found: (4, 4) world-to-camera, of as many views as were used.
        truth: one per photo, in any world; none, or the first view's among them.
    """
    if not truth or truth[0] is None:
        return []
    first = truth[0].extrinsics
    motions = [
        (motion(found[0], pose), motion(first, camera.extrinsics))
        for pose, camera in zip(found[1:], truth[1:], strict=False)
        if camera is not None
    ]
    return [(rotation_error(*both), direction_error(*both)) for both in motions]


def cells(errors: Mapping[str, float], headings: Sequence[str]) -> list[str]:
    """A row's errors under some of the headings; empty where it has none."""
    texts = []
    for names, form, _ in (COLUMNS[heading] for heading in headings):
        values = [errors[name] for name in names if name in errors]
        texts.append(form.format(*values) if values else "")
    return texts


def known_headings(rows: Sequence[Mapping[str, float]]) -> list[str]:
    """The headings under which any row has something."""
    return [head for head, each in COLUMNS.items() if any(each.names[0] in row for row in rows)]


def meanings(rows: Sequence[Mapping[str, float]]) -> list[str]:
    """What the columns are that any row has something in."""
    return [COLUMNS[heading].meaning for heading in known_headings(rows)]
