"""What a precision loses, in pictures of the scenes that it makes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.recover import recover
from styl3r_cli.errors import ModelError
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.pipeline import Stylizer
from styl3r_cli.tradeoff.agreement import (
    ATTRIBUTES,
    BROKEN_DB,
    Difference,
    View,
    compare_pictures,
    differences,
    watch,
    worst,
)
from styl3r_export.quantise.calibration import Sample

Made = tuple[Gaussians, list[Camera]]


@dataclass(frozen=True)
class Loss:
    """One sample through two models.

    Attributes:
        sample: its name.
        attributes: how far the Gaussians are off; empty if some were not finite.
        views: how alike pictures of both are, each from its own cameras.
    """

    sample: str
    attributes: dict[str, Difference]
    views: list[View]

    @property
    def worst(self) -> float:
        """PSNR of the worst view; not a number if there is no scene to look at."""
        return worst(self.views)

    @property
    def broken(self) -> bool:
        """Whether it is another scene: see BROKEN_DB."""
        return not self.worst >= BROKEN_DB


def rendered_loss(reference: Path, other: Path, samples: Sequence[Sample]) -> list[Loss]:
    """Make every sample's scene with both models, one model after the other, and compare them."""
    truths = _scenes(reference, samples)
    made = _scenes(other, samples)
    losses = []
    for sample, truth, value in zip(samples, truths, made, strict=True):
        assert truth is not None
        height, width = sample.photos.images.shape[2:]
        if value is None:
            losses.append(Loss(sample.name, {}, []))
            continue
        seen, wanted = (watch(*scene, (width, height), None) for scene in (value, truth))
        views = compare_pictures(seen, wanted, len(sample.photos.images))
        losses.append(Loss(sample.name, differences(value[0], truth[0]), views))
    return losses


def _scenes(folder: Path, samples: Sequence[Sample]) -> list[Made | None]:
    """Scenes and their cameras; None where a model gives nothing finite."""
    stylizer = Stylizer(str(folder), "cpu")
    made: list[Made | None] = []
    for sample in samples:
        scene = stylizer.encode(sample.photos)
        measured = sample.photos.focals_measured
        try:
            gaussians, _ = stylizer.gaussians(
                scene, sample.styles, strength=1.0 if sample.styles else 0.0
            )
            found = recover(scene.means, scene.opacities, scene.intrinsics, measured)
            made.append((gaussians, found.cameras))
        except ModelError:
            made.append(None)
    return made


def table(losses: Sequence[Loss]) -> str:
    """The losses, as text columns: pictures in dB, attributes as relative errors."""
    head = "".join(f"{name:>11}" for name in ATTRIBUTES)
    lines = [f"{'scene':24}{'worst view':>11}{'median':>9}{'SSIM':>8}{head}"]
    for loss in losses:
        decibels = sorted(view.psnr for view in loss.views)
        similar = sorted(view.ssim for view in loss.views)
        middle = len(decibels) // 2
        shown = (
            f"{loss.worst:8.1f} dB{decibels[middle]:6.1f} dB{similar[middle]:8.4f}"
            if decibels
            else f"{'nothing':>11}{'':17}"
        )
        errors = "".join(
            f"{loss.attributes[name].relative:11.1e}" if loss.attributes else f"{'':11}"
            for name in ATTRIBUTES
        )
        lines.append(f"{loss.sample[:23]:24}{shown}{errors}")
    return "\n".join(lines)
