"""How far one scene is from another: Gaussian by Gaussian, and as pictures of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.poses import blend, from_camera, to_camera
from styl3r_cli.frames import Picture, to_picture
from styl3r_cli.gaussians import FloatArray, Gaussians
from styl3r_cli.picture_metrics import psnr, ssim

ATTRIBUTES = ("means", "scales", "rotations", "opacities", "colours")
BETWEEN = 0.5  # novel cameras stand halfway between two views that follow each other
# Below this, a picture of the scene is visibly another picture. A precision that falls below it,
# or gives values that are not finite, is marked as broken and never recommended.
BROKEN_DB = 30.0


@dataclass(frozen=True)
class Difference:
    """How far off one attribute is.

    Attributes:
        largest: largest absolute difference, in the attribute's units.
        relative: root mean square of the difference over that of the reference's values.
    """

    largest: float
    relative: float


@dataclass(frozen=True)
class View:
    """How alike two pictures from one camera are; `novel` means from between the photos."""

    novel: bool
    psnr: float
    ssim: float


def differences(scene: Gaussians, reference: Gaussians) -> dict[str, Difference]:
    """How far every attribute is off; empty where the scenes' Gaussians do not correspond.

    Rotations count without their sign: q and -q are one rotation.
    """
    if len(scene) != len(reference) or not len(scene):
        return {}
    return {name: _difference(name, scene, reference) for name in ATTRIBUTES}


def _difference(name: str, scene: Gaussians, reference: Gaussians) -> Difference:
    value = getattr(scene, name).astype(np.float64)
    truth = getattr(reference, name).astype(np.float64)
    if name == "rotations":
        value *= np.where((value * truth).sum(axis=1, keepdims=True) < 0, -1, 1)
    off = value - truth
    size = max(float(np.sqrt(np.square(truth).mean())), float(np.finfo(np.float32).tiny))
    return Difference(float(np.abs(off).max()), float(np.sqrt(np.square(off).mean())) / size)


def between(cameras: Sequence[Camera]) -> list[Camera]:
    """A camera halfway between each view and the one after it."""
    poses = [from_camera(camera) for camera in cameras]
    pairs = zip(poses, poses[1:], cameras, strict=False)
    return [to_camera(blend(a, b, BETWEEN), like) for a, b, like in pairs]


def watch(
    gaussians: Gaussians, cameras: Sequence[Camera], size: tuple[int, int], threads: int | None
) -> list[Picture]:
    """Pictures of a scene from its views' cameras, then from between them, all (width, height)."""
    from styl3r_cli.splatting import render

    seen = [camera.resized(*size) for camera in (*cameras, *between(cameras))]
    return [to_picture(render(gaussians, camera, threads=threads).colour) for camera in seen]


def compare_pictures(
    pictures: Sequence[Picture], reference: Sequence[Picture], views: int
) -> list[View]:
    """Each picture against the reference's; the first `views` are the input cameras'."""
    pairs = enumerate(zip(pictures, reference, strict=True))
    return [View(i >= views, *_alike(unit(a), unit(b))) for i, (a, b) in pairs]


def _alike(a: FloatArray, b: FloatArray) -> tuple[float, float]:
    return psnr(a, b), ssim(a, b)


def unit(picture: Picture) -> FloatArray:
    """8 bits to [0, 1]."""
    return picture.astype(np.float32) / np.float32(255)


def worst(views: Sequence[View]) -> float:
    """The PSNR of the view that agrees least: what a setting promises holds in every view."""
    return min((view.psnr for view in views), default=float("nan"))
