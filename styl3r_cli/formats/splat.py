""".splat: 32 bytes a Gaussian and nothing else, for the first web viewers (antimatter15)."""

from __future__ import annotations

import numpy as np

from styl3r_cli.errors import InputError, OutputError
from styl3r_cli.formats.quantise import to_bytes
from styl3r_cli.formats.scene import Encoded, Scene
from styl3r_cli.formats.values import clipped, finite_only, in_float32, left_out, unit
from styl3r_cli.gaussians import Gaussians

ROW = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("rgba", "u1", 4), ("turn", "u1", 4)])
ZERO = 128  # a rotation's parts w x y z are bytes around this one; 128 steps make 1
LOSS = ".splat rounds colours, opacities and rotations to 8 bits"
# A file of this format says nothing of itself. In one, (nearly) all rotations have length 1 to
# within their rounding; random bytes hardly ever do.
LENGTH_ERROR = 0.03
RECOGNISED = 0.95  # of the rows
# Of its first ones alone, which may be odd ones. Fewer rows than these say nothing yet.
LIKELY, LIKELY_ROWS = 0.5, 256


def encode(gaussians: Gaussians, metadata: dict[str, str]) -> Encoded:
    """Means and scales (linear) as float32; sRGB, opacity and rotation w x y z as bytes.

    Args:
        gaussians: the scene; colours are clipped to [0, 1].
        metadata: left out, with a note.

    Raises:
        OutputError: the scene has no Gaussian.
    """
    notes: list[str] = []
    scene = finite_only(gaussians, notes)
    kept = scene.gaussians
    if not len(kept):
        raise OutputError("a .splat of no Gaussian is an empty file, which no program reads")
    rows = np.empty(len(kept), ROW)
    rows["means"], rows["scales"] = kept.means, kept.scales
    rows["rgba"] = to_bytes(np.column_stack([kept.colours, kept.opacities]))
    rows["turn"] = np.rint(unit(kept.rotations) * ZERO + ZERO).clip(0, 255).astype(np.uint8)
    notes += [LOSS, *clipped(kept.colours, 0, 1), *left_out(metadata, ".splat")]
    return Encoded(rows.tobytes(), len(kept), scene.dropped, notes)


def decode(data: bytes, name: str) -> Scene:
    """Read rows of 32 bytes.

    Args:
        data: the whole file.
        name: what to call it in messages.

    Raises:
        InputError: the file is empty, or its length is no multiple of a row's.
    """
    if not data:  # a scene of nothing, by the letter; a file that was never filled, in truth
        raise InputError(f"{name}: the file is empty")
    if len(data) % ROW.itemsize:
        raise InputError(
            f"{name}: not a .splat, or cut off: {len(data)} bytes are not rows of {ROW.itemsize}"
        )
    rows = np.frombuffer(data, ROW)
    rgba = rows["rgba"] / np.float32(255)
    rotations = unit((rows["turn"].astype(np.float64) - ZERO) / ZERO)
    gaussians = in_float32(
        means=rows["means"],
        scales=np.abs(rows["scales"]),  # a negative one is the same Gaussian
        rotations=rotations,
        opacities=rgba[:, 3],
        colours=rgba[:, :3],
    )
    return finite_only(gaussians, [])


def recognised(data: bytes) -> bool:
    """Whether bytes that say nothing of themselves look like a .splat."""
    if not data or len(data) % ROW.itemsize:
        return False
    return _plausible(data) >= RECOGNISED


def begins(begun: bytes) -> bool | None:
    """Whether bytes may be the beginning of a .splat; None where there are too few of them."""
    rows = len(begun) // ROW.itemsize
    return None if rows < LIKELY_ROWS else _plausible(begun[: rows * ROW.itemsize]) >= LIKELY


def _plausible(data: bytes) -> float:
    """The share of rows whose rotations are ones."""
    rows = np.frombuffer(data, ROW)
    length = np.linalg.norm((rows["turn"].astype(np.float64) - ZERO) / ZERO, axis=1)
    return float((np.abs(length - 1) < LENGTH_ERROR).mean())
