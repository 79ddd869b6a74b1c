"""Intrinsics of the views: given, from EXIF, or assumed, and what to say about it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.errors import InputError
from styl3r_cli.photos.expand import name_some
from styl3r_cli.photos.focal import (
    ASSUMED_FOCAL,
    NARROWEST_FOV,
    WIDEST_FOV,
    equivalent_from_focal,
    focal_from_equivalent,
    focal_from_fov,
)

FocalSource = Literal["cameras", "fov", "exif", "other photos", "assumed"]
# Lenses that breathe and EXIF that rounds stay within a few per cent; zooming does not.
ZOOMED = 1.05
# A camera made for a scaled copy of the photo has its size rounded to whole pixels.
ASPECT_TOLERANCE = 0.01


def view_intrinsics(
    names: Sequence[str],
    sizes: Sequence[tuple[int, int]],
    cameras: Sequence[Camera | None],
    fov: float | None,
    equivalents: Sequence[float | None],
    notes: list[str],
) -> tuple[list[NDArray[np.float64]], list[FocalSource]]:
    """Each view's intrinsics in pixels of the photo as shown, and where they are from.

    Args:
        names: of the views, for the notes.
        sizes: (width, height) of the photos as shown.
        cameras: known cameras, which come first; their frames may be scaled copies of the photos.
        fov: horizontal field of view in degrees for all other views.
        equivalents: 35 mm equivalent focal lengths from EXIF, in mm.
        notes: gets a line on assumed and on differing focal lengths.

    Returns:
        (3, 3) matrices and sources, one per view.

    Raises:
        InputError: a camera's frame has another shape than its photo.
        UsageError: `fov` is out of range.
    """
    measured = [value for value in equivalents if value is not None]
    substitute = float(np.median(measured)) if measured else ASSUMED_FOCAL
    matrices: list[NDArray[np.float64]] = []
    sources: list[FocalSource] = []
    for name, (width, height), camera, equivalent in zip(
        names, sizes, cameras, equivalents, strict=True
    ):
        if camera is not None:
            matrices.append(_scaled_camera(camera, width, height, name).intrinsics)
            sources.append("cameras")
            continue
        source: FocalSource
        if fov is not None:
            focal, source = focal_from_fov(fov, width), "fov"
        elif equivalent is not None:
            focal, source = focal_from_equivalent(equivalent, width, height), "exif"
        else:
            focal = focal_from_equivalent(substitute, width, height)
            source = "other photos" if measured else "assumed"
        matrices.append(np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]]))
        sources.append(source)
    notes += _assumption_notes(names, sources, substitute)
    notes += _zoom_notes(names, sizes, matrices)
    return matrices, sources


def same_shape(a: tuple[int, int], b: tuple[int, int]) -> bool:
    """Whether one (width, height) can be of a scaled copy of a picture of the other."""
    # Rounding to whole pixels may change a tiny frame's shape by more than the tolerance.
    allowed = ASPECT_TOLERANCE + 1 / min(*a, *b)
    return abs((a[0] / a[1]) / (b[0] / b[1]) - 1) <= allowed


def _scaled_camera(camera: Camera, width: int, height: int, name: str) -> Camera:
    if not same_shape((camera.width, camera.height), (width, height)):
        raise InputError(
            f"{name}: the photo is {width}x{height}, but its camera is for "
            f"{camera.width}x{camera.height}; cameras must be of the photos as shown"
        )
    for focal, side in ((camera.fx, camera.width), (camera.fy, camera.height)):
        degrees = math.degrees(2 * math.atan(side / 2 / focal))
        if not NARROWEST_FOV <= degrees <= WIDEST_FOV:
            raise InputError(
                f"{name}: its camera sees {degrees:.3g} degrees; the network takes "
                f"{NARROWEST_FOV:g} to {WIDEST_FOV:g}"
            )
    return camera.resized(width, height)


def _assumption_notes(
    names: Sequence[str], sources: Sequence[FocalSource], substitute: float
) -> list[str]:
    without = [
        name
        for name, source in zip(names, sources, strict=True)
        if source in ("other photos", "assumed")
    ]
    if not without:
        return []
    how = "assumed" if "assumed" in sources else "taken from the other photos"
    return [
        f"no focal length in {name_some(without)}: {_rounded(substitute)} mm equivalent {how} "
        "(--fov or --cameras sets it)"
    ]


def _zoom_notes(
    names: Sequence[str],
    sizes: Sequence[tuple[int, int]],
    matrices: Sequence[NDArray[np.float64]],
) -> list[str]:
    focals = [
        equivalent_from_focal(matrix[0, 0], *size)
        for matrix, size in zip(matrices, sizes, strict=True)
    ]
    shortest, longest = int(np.argmin(focals)), int(np.argmax(focals))
    if focals[longest] <= ZOOMED * focals[shortest]:
        return []
    return [
        f"focal lengths differ: {_rounded(focals[shortest])} mm equivalent in {names[shortest]}, "
        f"{_rounded(focals[longest])} mm in {names[longest]}"
    ]


def _rounded(value: float) -> str:
    """Three digits, without an exponent."""
    return f"{float(f'{value:.3g}'):g}"
