"""What all scene formats do to values: activations, checks, and what is said about losses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.stored import cameras_from_metadata
from styl3r_cli.errors import InputError
from styl3r_cli.formats.scene import Scene
from styl3r_cli.gaussians import Gaussians

SH_C0 = 0.28209479177387814  # the constant spherical harmonic, 1 / (2 sqrt(pi))
# sigmoid(18) is 1 in float32 and every float32 below 1 has a smaller logit, so 1 comes back as 1;
# 0 comes back as 1.5e-8, which no renderer draws; and no viewer meets an infinity.
LOGIT_LIMIT = 18.0
# Far below a pixel in any scene, far above where float32 covariances (squares) underflow.
SMALLEST_SCALE = 1e-10
COLOUR_LIMIT = 1e37  # so that division by SH_C0 stays in float32
# No format needs less than a byte for a Gaussian of a real scene. A small file that claims more
# (a lie, or a decompression bomb) is refused before its claim is believed with memory.
BELIEVED = 1 << 20
UNIT_ERROR = 2.0**-22  # of a quaternion's length, after four parts were rounded to float32
CLIPPING_SEEN = 0.5 / 255  # of a colour: less is rounding
# A scene's extent is that of all but a few of its Gaussians: some are often far out.
LOW, HIGH = 0.02, 0.98
ROUNDING_SEEN = 1e-3  # of the extent: a pixel of a frame of a thousand
ATTRIBUTES = ("means", "scales", "rotations", "opacities", "colours")


def finite_only(gaussians: Gaussians, notes: list[str]) -> Scene:
    """The Gaussians whose values are all finite; how many are not is counted and noted."""
    finite = np.ones(len(gaussians), bool)
    counts = {}
    for name in ATTRIBUTES:
        good = np.isfinite(getattr(gaussians, name))
        good = good.all(axis=1) if good.ndim > 1 else good
        if not good.all():
            counts[name] = int(len(good) - good.sum())
        finite &= good
    dropped = int(len(finite) - finite.sum())
    if not dropped:
        return Scene(gaussians, notes=notes)
    notes.append(f"{dropped} of {len(finite)} Gaussians were not finite and left out")
    return Scene(gaussians.select(finite), {}, notes, dropped, counts)


def in_float32(
    means: NDArray[np.floating],
    scales: NDArray[np.floating],
    rotations: NDArray[np.floating],
    opacities: NDArray[np.floating],
    colours: NDArray[np.floating],
) -> Gaussians:
    """Gaussians of values as read; too large ones become infinite, for `finite_only` to find."""
    with np.errstate(over="ignore", invalid="ignore"):
        arrays = (means, scales, rotations, opacities, colours)
        return Gaussians(*(array.astype(np.float32) for array in arrays))


def rounded(means: NDArray[np.floating]) -> list[str]:
    """A note on (G, 3) means, as read, that float32 moves far: maps in metres have such ones."""
    if means.dtype == np.float32 or not len(means):
        return []
    with np.errstate(over="ignore", invalid="ignore"):
        moved = np.abs(means - means.astype(np.float32)).max(axis=1)
    finite = np.isfinite(moved)
    if not moved[finite].any():
        return []
    low, high = np.quantile(means[finite], (LOW, HIGH), axis=0)
    extent, most = float((high - low).max()), float(moved[finite].max())
    if most <= ROUNDING_SEEN * extent or not extent:
        return []
    return [
        f"means are rounded to single precision, by up to {most:.2g} in a scene {extent:.2g} wide; "
        "move it nearer to its origin first"
    ]


def check_count(count: int, size: int, name: str) -> None:
    """Refuse a number of Gaussians that a file of `size` bytes cannot hold.

    Raises:
        InputError: it is negative, or more than a megabyte's worth and than the file has bytes.
    """
    if count < 0 or count > max(BELIEVED, size):
        raise InputError(f"{name}: damaged: it claims {count} Gaussians in {size} bytes")


def left_out(metadata: Mapping[str, str], kind: str) -> list[str]:
    """A note on the cameras and other text that a format has no place for."""
    cameras = len(cameras_from_metadata(metadata))
    if cameras:
        return [f"{kind} has no place for cameras: {cameras} are left out"]
    return [f"{kind} has no place for metadata: it is left out"] if metadata else []


def clipped(colours: NDArray[np.floating], low: float, high: float) -> list[str]:
    """A note on colours that are outside of what a format can store."""
    outside = (colours < low - CLIPPING_SEEN) | (colours > high + CLIPPING_SEEN)
    count = int(outside.any(axis=1).sum())
    return (
        [f"{count} Gaussians had colours outside {low:.2g}..{high:.3g}: clipped"] if count else []
    )


def thickened(scales: NDArray[np.floating], least: float) -> list[str]:
    """A note on scales that are below what a format can store."""
    flat = int((scales < least).any(axis=1).sum())
    return [f"{flat} Gaussians were flatter than {least:.3g} and made so thick"] if flat else []


def thinned(scales: NDArray[np.floating], most: float) -> list[str]:
    """A note on scales that are above what a format can store."""
    large = int((scales > most).any(axis=1).sum())
    return [f"{large} Gaussians were thicker than {most:.4g} and made so thin"] if large else []


def logit(opacities: NDArray[np.float32]) -> NDArray[np.float64]:
    """The inverse of the sigmoid, finite at both ends."""
    opacity = opacities.astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        logits = np.log(opacity) - np.log1p(-opacity)
    logits = np.where(opacity >= 1, LOGIT_LIMIT, np.where(opacity <= 0, -LOGIT_LIMIT, logits))
    return logits.clip(-LOGIT_LIMIT, LOGIT_LIMIT)


def sigmoid(logits: NDArray[np.generic]) -> NDArray[np.float64]:
    """Opacities of logits."""
    return 1 / (1 + np.exp(-logits.astype(np.float64)))


def to_harmonics(colours: NDArray[np.float32]) -> NDArray[np.float64]:
    """Degree-0 spherical harmonics of sRGB colours, kept where float32 can hold them."""
    return (colours.clip(-COLOUR_LIMIT, COLOUR_LIMIT).astype(np.float64) - 0.5) / SH_C0


def from_harmonics(coefficients: NDArray[np.floating]) -> NDArray[np.float64]:
    """The sRGB colours of degree-0 spherical harmonics."""
    return 0.5 + SH_C0 * coefficients.astype(np.float64)


def unit(rotations: NDArray[np.floating]) -> NDArray[np.float64]:
    """Quaternions of length 1; one of length 0 turns nothing.

    Those that have it already, as far as float32 can, stay as they are to the last bit.
    """
    quaternions = rotations.astype(np.float64)
    length = np.linalg.norm(quaternions, axis=1, keepdims=True)
    divisor = np.where((length > 0) & (np.abs(length - 1) > UNIT_ERROR), length, 1)
    return np.where(length > 0, quaternions / divisor, np.array([1.0, 0.0, 0.0, 0.0]))


def turned(gaussians: Gaussians) -> Gaussians:
    """Half a turn about x: from OpenCV's axes (y down, z forward) to y up, z back, or back again.

    Exact and its own inverse: the Gaussians' own axes y and z are turned round too, which changes
    none of them, so that a rotation's w and x stay and its y and z change sign.
    """
    signs = np.array([1, -1, -1], np.float32)
    return Gaussians(
        gaussians.means * signs,
        gaussians.scales,
        gaussians.rotations * np.array([1, 1, -1, -1], np.float32),
        gaussians.opacities,
        gaussians.colours,
    )
