"""Cameras of centre crops: from a whole photo to a frame of another shape, and back."""

from __future__ import annotations

import math
from dataclasses import replace

from styl3r_cli.cameras.camera import Camera


def cropped(camera: Camera, width: int, height: int) -> Camera:
    """The view scaled until it just covers a frame, and cropped to its centre.

    Args:
        camera: of the whole picture.
        width: of the frame, pixels.
        height: of the frame, pixels.
    """
    factor = max(width / camera.width, height / camera.height)
    return replace(
        camera,
        fx=camera.fx * factor,
        fy=camera.fy * factor,
        cx=width / 2 + (camera.cx - camera.width / 2) * factor,
        cy=height / 2 + (camera.cy - camera.height / 2) * factor,
        width=width,
        height=height,
    )


def uncropped(camera: Camera, width: int, height: int) -> Camera:
    """The camera of the whole photo that was scaled and cropped to the given camera's frame.

    The inverse of `photos.resize.fit_intrinsics`, its rounding to whole pixels included.

    Args:
        camera: of the crop.
        width: of the photo as shown, pixels.
        height: of the photo as shown, pixels.
    """
    factor = max(camera.width / width, camera.height / height)
    across, down = round(width * factor) / width, round(height * factor) / height
    return replace(
        camera,
        fx=camera.fx / across,
        fy=camera.fy / down,
        cx=width / 2 + (camera.cx - camera.width / 2) / across,
        cy=height / 2 + (camera.cy - camera.height / 2) / down,
        width=width,
        height=height,
    )


def with_fov(camera: Camera, degrees: float) -> Camera:
    """The camera with another lens: square pixels, centred, and this horizontal field of view."""
    focal = camera.width / 2 / math.tan(math.radians(degrees) / 2)
    return replace(camera, fx=focal, fy=focal, cx=camera.width / 2, cy=camera.height / 2)
