"""PlayCanvas's SOG, version 2: a zip of lossless WebP pictures, a pixel a Gaussian, and meta.json.

Specification: https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog. Axes
are those of the PLY, as PlayCanvas's splat-transform writes and reads them.
"""

from __future__ import annotations

import io
import json
import zipfile

import numpy as np
from numpy.typing import NDArray

from styl3r_cli import __version__
from styl3r_cli.formats.codebook import make_codebook
from styl3r_cli.formats.quantise import (
    HALF,
    from_smallest_three,
    morton_order,
    smallest_three,
    to_bytes,
    to_levels,
)
from styl3r_cli.formats.scene import Encoded, Scene
from styl3r_cli.formats.sog_container import KEY, Archive, open_archive
from styl3r_cli.formats.values import (
    SMALLEST_SCALE,
    finite_only,
    from_harmonics,
    in_float32,
    thickened,
    to_harmonics,
    unit,
)
from styl3r_cli.gaussians import Gaussians

TOP = (1 << 16) - 1  # of a mean's coordinate: two bytes, each in a picture of its own
LARGEST = 252  # alpha of a rotation's pixel, if its largest part is the first of w x y z
MULTIPLE = 4  # of the pictures' sides, as texture formats like them
# zip stores a time for each file; the first that it knows makes the same bytes of the same scene.
TIME = (1980, 1, 1, 0, 0, 0)
LOSS = (
    ".sog rounds: means to 16 bits (finer near the origin), scales and colours to the nearest of "
    "256, rotations and opacities to 8 bits; Gaussians are sorted along a curve in space"
)


def encode(gaussians: Gaussians, metadata: dict[str, str]) -> Encoded:
    """A bundle without view-dependent colours; metadata in a key of meta.json of its own.

    Args:
        gaussians: the scene.
        metadata: any text.
    """
    notes: list[str] = []
    scene = finite_only(gaussians, notes)
    kept = scene.gaussians.select(morton_order(scene.gaussians.means))
    notes += [LOSS, *thickened(kept.scales, SMALLEST_SCALE)]
    logs = np.log(np.maximum(kept.scales, SMALLEST_SCALE, dtype=np.float64))
    scale_book, scales = make_codebook(logs)
    colour_book, colours = make_codebook(to_harmonics(kept.colours))
    low, high, fractions = _compressed_means(kept.means)
    levels = to_levels(fractions, TOP)
    pictures = {
        "means_l": (levels & 255).astype(np.uint8),
        "means_u": (levels >> 8).astype(np.uint8),
        "scales": scales,
        "quats": _turn_pixels(kept),
        "sh0": np.column_stack([colours, to_bytes(kept.opacities)]),
    }
    meta = {
        "version": 2,
        "asset": {"generator": f"styl3r {__version__}"},
        "count": len(kept),
        "means": {"mins": low, "maxs": high, "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": scale_book.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": colour_book.tolist(), "files": ["sh0.webp"]},
    }
    if metadata:
        meta[KEY] = metadata
    return Encoded(_bundle(meta, pictures, len(kept)), len(kept), scene.dropped, notes)


def decode(data: bytes, name: str) -> Scene:
    """Read a bundle; view-dependent colours are ignored.

    Args:
        data: the whole file.
        name: what to call it in messages.

    Raises:
        InputError: it is no SOG bundle of version 2, or damaged.
    """
    archive = open_archive(data, name)
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is dropped just below
        pixels = archive.picture("sh0", 0)
        quats = archive.picture("quats", 0)
        others = (quats[:, :3] / 255 - 0.5) * 2 * HALF
        largest = quats[:, 3].astype(int).clip(LARGEST, LARGEST + 3) - LARGEST
        scales = np.exp(archive.codebook("scales")[archive.picture("scales", 0)[:, :3]])
        gaussians = in_float32(
            means=_means(archive),
            scales=scales,
            rotations=from_smallest_three(largest, others),
            opacities=(pixels[:, 3] / 255),
            colours=from_harmonics(archive.codebook("sh0")[pixels[:, :3]]),
        )
    notes = ["view-dependent colours (shN) are ignored"] if "shN" in archive.meta else []
    kept = finite_only(gaussians, notes)
    return Scene(kept.gaussians, archive.metadata(), notes, kept.dropped, kept.non_finite)


def _compressed_means(
    means: NDArray[np.float32],
) -> tuple[list[float], list[float], NDArray[np.float64]]:
    """The range of sign(x) ln(1 + |x|) on each axis, and where in it each Gaussian is."""
    if not len(means):
        return [0.0] * 3, [0.0] * 3, np.zeros((0, 3))
    logs = np.sign(means) * np.log1p(np.abs(means.astype(np.float64)))
    low, high = logs.min(axis=0), logs.max(axis=0)
    return low.tolist(), high.tolist(), (logs - low) / np.where(high > low, high - low, 1)


def _means(archive: Archive) -> NDArray[np.float64]:
    low, high = archive.vector("mins"), archive.vector("maxs")
    levels = archive.picture("means", 0)[:, :3] + 256.0 * archive.picture("means", 1)[:, :3]
    logs = low + levels / TOP * (high - low)
    return np.sign(logs) * np.expm1(np.abs(logs))


def _turn_pixels(gaussians: Gaussians) -> NDArray[np.uint8]:
    largest, others = smallest_three(unit(gaussians.rotations))
    parts = to_bytes(others / HALF / 2 + 0.5)
    return np.column_stack([parts, (largest + LARGEST).astype(np.uint8)])


def _bundle(meta: dict[str, object], pictures: dict[str, NDArray[np.uint8]], count: int) -> bytes:
    width = _rounded(np.sqrt(count))
    height = _rounded(count / width)
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_STORED) as archive:
        for name, pixels in pictures.items():
            data = _webp(pixels, width, height)
            archive.writestr(zipfile.ZipInfo(f"{name}.webp", TIME), data)
        text = json.dumps(meta, separators=(",", ":"), allow_nan=False)
        archive.writestr(zipfile.ZipInfo("meta.json", TIME), text)
    return whole.getvalue()


def _rounded(side: float) -> int:
    return max(1, int(np.ceil(side / MULTIPLE))) * MULTIPLE


def _webp(pixels: NDArray[np.uint8], width: int, height: int) -> bytes:
    """A lossless picture of (G, 3 or 4) pixels, row by row, opaque black after the last."""
    from PIL import Image

    whole = np.zeros((height * width, 4), np.uint8)
    whole[:, 3] = 255
    whole[: len(pixels), : pixels.shape[1]] = pixels
    buffer = io.BytesIO()
    picture = Image.fromarray(whole.reshape(height, width, 4))
    # Without `exact`, colours under alpha 0 would be lost.
    picture.save(buffer, "webp", lossless=True, exact=True)
    return buffer.getvalue()
