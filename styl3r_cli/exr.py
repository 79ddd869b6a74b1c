"""Frames for compositors: scene-linear OpenEXR with alpha, depth and the camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.files import atomic_write
from styl3r_cli.gaussians import FloatArray
from styl3r_cli.video import frame_rate

if TYPE_CHECKING:
    from styl3r_cli.splatting import Frame

# All but DWAA and DWAB, which blur colours a little to a fraction of the size, keep every bit.
COMPRESSIONS = ("zip", "zips", "piz", "rle", "none", "dwaa", "dwab")
# Depth where there is nothing: what Blender writes. Far behind everything for a depth merge, and
# unlike infinity it survives a filter that multiplies it by 0.
EMPTY_DEPTH = 1e10
LARGEST_HALF = 65504.0
# Lossy compressions overshoot beside bright edges, by up to 3 %; half floats end in infinity.
LOSSY, LARGEST_LOSSY = ("dwaa", "dwab"), 50_000.0
# Red, green, blue and white of Rec. 709, as x and y; and the name that OpenEXR 3.4 has for them.
REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
COLOUR_SPACE = "lin_rec709_scene"
# sRGB's transfer function (IEC 61966-2-1): a straight line up to the knee, then a power.
KNEE, SLOPE = 0.04045, 12.92
OFFSET, EXPONENT = 0.055, 2.4
# OpenEXR's camera space is left-handed: y up, and z forward as ours.
EXR_FROM_OPENCV = np.diag([1.0, -1.0, 1.0, 1.0])


@dataclass(frozen=True)
class ExrOptions:
    """How frames are stored.

    Attributes:
        compression: one of COMPRESSIONS.
        multi_part: colours and depth in parts of their own ("rgba", "depth") instead of one part,
            which every reader opens.
        fps: frames per second of the sequence.
        provenance: what made the frame, by name, as text; the standard attribute `comments` gets
            it too, in one line.
    """

    compression: str = "zip"
    multi_part: bool = False
    fps: float | None = None
    provenance: Mapping[str, str] = field(default_factory=dict)


def write_exr(path: Path, frame: Frame, camera: Camera, options: ExrOptions) -> None:
    """Write one frame: R, G, B, A as half floats and Z as float, in scan lines.

    Colours are scene-linear Rec. 709, multiplied by alpha. Gaussians are blended in sRGB, so the
    blend is divided by alpha, made linear, and multiplied by alpha again. Z is the mean distance
    along the view axis in scene units, EMPTY_DEPTH where alpha is 0. The standard attributes
    `worldToCamera` and `worldToNDC` hold the camera.

    Args:
        path: where to write.
        frame: rendered without a background.
        camera: the frame's.
        options: how to store it.

    Raises:
        OutputError: the file cannot be written.
    """
    import OpenEXR

    header = _header(camera, options)
    colour, depth = _colour_channels(frame, options), {"Z": _depth(frame)}
    if options.multi_part:
        parts = [
            OpenEXR.Part(dict(header), colour, "rgba"),
            OpenEXR.Part(dict(header), depth, "depth"),
        ]
        file = OpenEXR.File(parts)
    else:
        file = OpenEXR.File(header, colour | depth)
    # The library's own files swallow what fails when they are closed, as on a disk that is full.
    with atomic_write(path) as temporary, temporary.open("wb") as stream:
        file.write(stream)


def _header(camera: Camera, options: ExrOptions) -> dict[str, Any]:
    import OpenEXR

    told = options.provenance
    compression = "NO" if options.compression == "none" else options.compression.upper()
    header: dict[str, Any] = {
        "compression": getattr(OpenEXR, f"{compression}_COMPRESSION"),
        "type": OpenEXR.scanlineimage,
        "chromaticities": REC709,
        "colorInteropID": COLOUR_SPACE,
        "worldToCamera": _row_vectors(EXR_FROM_OPENCV @ camera.extrinsics),
        "worldToNDC": _row_vectors(_projection(camera) @ camera.extrinsics),
        **told,
    }
    if told:
        header["comments"] = "; ".join(f"{name}: {value}" for name, value in told.items())
    if options.fps is not None:
        header["framesPerSecond"] = frame_rate(options.fps)
    return header


def _colour_channels(frame: Frame, options: ExrOptions) -> dict[str, NDArray[np.float16]]:
    largest = LARGEST_LOSSY if options.compression in LOSSY else LARGEST_HALF
    colour = linear_premultiplied(frame.colour, frame.alpha).clip(0, largest)
    channels = {
        name: np.ascontiguousarray(colour[..., index], np.float16)
        for index, name in enumerate("RGB")
    }
    return channels | {"A": frame.alpha.astype(np.float16)}


def _depth(frame: Frame) -> FloatArray:
    return np.where(frame.alpha > 0, frame.depth, np.float32(EMPTY_DEPTH))


def linear_premultiplied(colour: FloatArray, alpha: FloatArray) -> FloatArray:
    """(H, W, 3) sRGB times alpha to linear times alpha; negative colours become 0."""
    weight = alpha[..., None]
    straight = np.divide(colour, weight, out=np.zeros_like(colour), where=weight > 0)
    return linear_from_srgb(straight) * weight


def linear_from_srgb(colour: FloatArray) -> FloatArray:
    """Undo sRGB's transfer function, continued above 1; below 0 there is nothing."""
    positive = np.clip(colour, 0, LARGEST_HALF)  # the power of more could overflow
    power = ((positive + OFFSET) / (1 + OFFSET)) ** EXPONENT
    return np.where(positive <= KNEE, positive / SLOPE, power).astype(np.float32)


def _projection(camera: Camera) -> NDArray[np.float64]:
    """Camera space to OpenEXR's NDC: (0, 0) and (1, 1) are the frame's corners, y goes down.

    The third coordinate, which readers discard, is 1 / z: so the matrix has an inverse.
    """
    return np.array(
        [
            [camera.fx / camera.width, 0, camera.cx / camera.width, 0],
            [0, camera.fy / camera.height, camera.cy / camera.height, 0],
            [0, 0, 0, 1],
            [0, 0, 1, 0],
        ]
    )


def _row_vectors(matrix: NDArray[np.float64]) -> NDArray[np.float32]:
    """As OpenEXR's matrices are: points are rows, multiplied from the left."""
    return np.ascontiguousarray(matrix.T, np.float32)
