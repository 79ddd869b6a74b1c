"""How much of a painting's manner arrives, and how much of the photo stays."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.errors import InputError
from styl3r_cli.frames import Drawing
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.photos.expand import PHOTO_SUFFIXES
from styl3r_cli.photos.load import load_style
from styl3r_export.curriculum.perceptual import content_distance, style_distance
from styl3r_export.curriculum.pictures import HELD_OUT
from styl3r_export.evaluate.groups import Group
from styl3r_export.evaluate.histogram import histogram, histogram_distance
from styl3r_export.evaluate.image_metrics import edge_ssim
from styl3r_export.evaluate.records import MODEL, Values
from styl3r_export.evaluate.teachers import Teachers, features

NONE = "no stylization"

Picture = NDArray[np.floating]


@dataclass(frozen=True)
class Painting:
    """A style picture, and what the measures know of it."""

    name: str
    picture: Picture  # (side, side, 3) in [0, 1]
    features: list[torch.Tensor]
    histogram: NDArray[np.float64]

    @property
    def image(self) -> NDArray[np.float32]:
        """(3, side, side), as the pipeline reads it."""
        return np.ascontiguousarray(self.picture.transpose(2, 0, 1), np.float32)


def held_out_styles(folder: Path) -> list[Path]:
    """Every tenth picture of a folder in sorted order: those that training leaves alone.

    Raises:
        InputError: there is no picture.
    """
    files = sorted(p for p in folder.rglob("*") if p.suffix.lower() in PHOTO_SUFFIXES)
    if not files:
        raise InputError(f"{folder}: no pictures in it")
    return files[::HELD_OUT]


def choose_style(styles: Sequence[Path], scene: str, number: int) -> Path:
    """A style for a scene's group: the same in every run, another for the next group."""
    return styles[(zlib.crc32(scene.encode()) + number) % len(styles)]


def load_painting(path: Path, side: int, teachers: Teachers) -> Painting:
    """Read a style picture as the tool does.

    Raises:
        InputError: it cannot be read.
    """
    picture = load_style(path, side).image.transpose(1, 2, 0)
    return Painting(path.name, picture, features(teachers.vgg, picture), histogram(picture))


def style_values(
    group: Group,
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    painting: Painting,
    teachers: Teachers,
    threads: int,
) -> Values:
    """Distances to the painting and to the photo, of the first and the last view.

    The model's pictures are rendered from its stylized Gaussians at the recovered cameras of those
    views. Beside it: the photos themselves, and 2D stylizers on the photos, frame by frame.

    Args:
        group: the photos.
        gaussians: stylized.
        cameras: the recovered ones.
        painting: the style.
        teachers: measures and 2D stylizers.
        threads: for the renderer.
    """
    values: Values = {}
    drawing = Drawing(threads=threads)
    for index in (0, len(group.inputs) - 1):
        photo = group.views[index].pixels / np.float32(255)
        original = features(teachers.vgg, photo)
        frames: dict[str, Picture] = {
            MODEL: drawing.frame(gaussians, cameras[index]).colour.clip(0, 1),
            NONE: photo,
        }
        for name, stylizer in teachers.stylizers.items():
            frames[name] = stylizer(photo, painting.picture)
        for method, frame in frames.items():
            seen = original if method == NONE else features(teachers.vgg, frame)
            measures = compare_style(frame, seen, painting)
            if method != NONE:  # which has nothing to lose
                measures |= compare_content(frame, seen, photo, original)
            for (what, measure), value in measures.items():
                values.setdefault((what, measure, method), []).append(value)
    return values


def compare_style(
    frame: Picture, seen: list[torch.Tensor], painting: Painting
) -> dict[tuple[str, str], float]:
    """How far a frame, of these features, is from a painting's manner and colours."""
    colours = histogram_distance(histogram(frame), painting.histogram)
    return {
        ("style", "mean/std distance"): float(style_distance(seen, painting.features)),
        ("style", "RGB-uv histogram distance"): colours,
    }


def compare_content(
    frame: Picture, seen: list[torch.Tensor], photo: Picture, original: list[torch.Tensor]
) -> dict[tuple[str, str], float]:
    """How far a frame is from showing what the photo shows; both with their features."""
    return {
        ("content", "perceptual distance"): float(content_distance(seen, original)),
        ("content", "SSIM of edges"): edge_ssim(frame, photo),
    }
