"""Niantic's .spz: bytes by attribute, compressed. Versions 2 to 4 are read, version 3 is written.

Layout: https://github.com/nianticlabs/spz#file-format. Versions 2 and 3 are one gzip stream;
version 4 is a plain header, a table, and a Zstandard stream an attribute. Version 3 is what the
most programs read. Axes are x right, y up, z back.
"""

from __future__ import annotations

import gzip
import struct

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.formats.quantise import HALF, from_smallest_three, smallest_three, to_bytes
from styl3r_cli.formats.scene import Encoded, Scene
from styl3r_cli.formats.spz_container import MAGIC, Packed, unpack
from styl3r_cli.formats.values import (
    SH_C0,
    clipped,
    finite_only,
    from_harmonics,
    in_float32,
    left_out,
    thickened,
    thinned,
    to_harmonics,
    turned,
    unit,
)
from styl3r_cli.gaussians import Gaussians

VERSION = 3
LEAST_FRACTION_BITS = 12  # of every other writer: a quarter of a millimetre where the unit is 1 m
STEPS_A_SCALE = 32  # small scenes get more bits: a median Gaussian is as thick as so many steps
MEAN_BITS = 24  # of a coordinate, with its sign
LOG_STEPS, SMALLEST_LOG = 16, -10.0  # of a scale's natural logarithm
LARGEST_LOG = SMALLEST_LOG + 255 / LOG_STEPS
COLOUR_GAIN = 0.15  # of a harmonic, around the middle of a byte
TURN_BITS = 9  # of a part of a rotation, beside its sign
GZIP_LEVEL = 9
LOSS = (
    ".spz rounds: means to 1/{step} of a unit, scales to steps of 6 %, rotations to 10 bits, "
    "colours and opacities to 8"
)


def encode(gaussians: Gaussians, metadata: dict[str, str]) -> Encoded:
    """Version 3, without view-dependent colours.

    Args:
        gaussians: the scene.
        metadata: left out, with a note.
    """
    notes: list[str] = []
    scene = finite_only(gaussians, notes)
    kept = turned(scene.gaussians)
    bits = _fraction_bits(kept)
    logs = np.log(np.maximum(kept.scales, np.exp(SMALLEST_LOG), dtype=np.float64))
    levels = np.rint((logs - SMALLEST_LOG) * LOG_STEPS).clip(0, 255)
    parts = [
        struct.pack("<IIIBBBB", MAGIC, VERSION, len(kept), 0, bits, 0, 0),
        _fixed_point(kept.means, bits, notes),
        to_bytes(kept.opacities).tobytes(),
        to_bytes(to_harmonics(kept.colours) * COLOUR_GAIN + 0.5).tobytes(),
        levels.astype(np.uint8).tobytes(),
        _pack_turns(unit(kept.rotations)).tobytes(),
    ]
    notes += [
        LOSS.format(step=1 << bits),
        *thickened(kept.scales, float(np.exp(SMALLEST_LOG))),
        *thinned(kept.scales, float(np.exp(LARGEST_LOG))),
    ]
    reach = 0.5 / COLOUR_GAIN * SH_C0
    notes += [*clipped(kept.colours, 0.5 - reach, 0.5 + reach), *left_out(metadata, ".spz")]
    data = gzip.compress(b"".join(parts), GZIP_LEVEL, mtime=0)  # no time: the same bytes again
    return Encoded(data, len(kept), scene.dropped, notes)


def decode(data: bytes, name: str) -> Scene:
    """Read version 2, 3 or 4; view-dependent colours are ignored.

    Args:
        data: the whole file.
        name: what to call it in messages.

    Raises:
        InputError: it is no .spz, of another version, or damaged.
    """
    packed = unpack(data, name)
    notes = ["view-dependent colours are ignored"] if packed.degree else []
    colours = (packed.colours.reshape(-1, 3) / 255 - 0.5) / COLOUR_GAIN
    scales = np.exp(packed.scales.reshape(-1, 3) / LOG_STEPS + SMALLEST_LOG)
    gaussians = in_float32(
        means=_from_fixed_point(packed),
        scales=scales,
        rotations=_turns(packed),
        opacities=packed.opacities / 255,
        colours=from_harmonics(colours),
    )
    return finite_only(turned(gaussians), notes)


def _fraction_bits(gaussians: Gaussians) -> int:
    """As many as the scene's smallness deserves, and its size leaves room for."""
    if not len(gaussians):
        return LEAST_FRACTION_BITS
    thick = float(np.median(gaussians.scales))
    wanted = np.ceil(np.log2(STEPS_A_SCALE / thick)) if thick > 0 else LEAST_FRACTION_BITS
    far = max(float(np.abs(gaussians.means).max()), 2.0**-MEAN_BITS)
    room = np.floor(MEAN_BITS - 1 - np.log2(far) - 1e-6)  # a little less: the far end is rounded
    return int(np.clip(min(max(wanted, LEAST_FRACTION_BITS), room), 0, MEAN_BITS - 1))


def _fixed_point(means: NDArray[np.float32], bits: int, notes: list[str]) -> bytes:
    """24-bit little-endian two's complement."""
    most = (1 << (MEAN_BITS - 1)) - 1
    steps = np.rint(means.astype(np.float64) * (1 << bits))
    far = int((np.abs(steps) > most).any(axis=1).sum())
    if far:
        notes.append(f"{far} Gaussians were too far out for .spz and moved to its border")
    whole = steps.clip(-most, most).astype("<i4")
    return whole.view(np.uint8).reshape(-1, 4)[:, :3].tobytes()


def _from_fixed_point(packed: Packed) -> NDArray[np.float64]:
    whole = np.zeros((packed.count * 3, 4), np.uint8)
    whole[:, 1:] = packed.means.reshape(-1, 3)  # in the upper bytes, so that the sign is at its end
    steps = whole.view("<i4") >> 8
    return steps.reshape(-1, 3) / float(1 << packed.fraction_bits)


def _pack_turns(quaternions: NDArray[np.float64]) -> NDArray[np.uint32]:
    """Index of the largest of x y z w, then sign and magnitude of the others, from the top down."""
    largest, others = smallest_three(np.roll(quaternions, -1, axis=1))
    most = (1 << TURN_BITS) - 1
    magnitudes = np.rint(np.abs(others) / HALF * most).clip(0, most).astype(np.uint32)
    parts = magnitudes | (others < 0).astype(np.uint32) << np.uint32(TURN_BITS)
    words = largest.astype("<u4")
    for part in parts.T:
        words = words << np.uint32(TURN_BITS + 1) | part
    return words.astype("<u4")


def _turns(packed: Packed) -> NDArray[np.float64]:
    """Unit quaternions w x y z."""
    if packed.version == 2:
        xyz = packed.rotations.reshape(-1, 3) / 127.5 - 1
        w = np.sqrt(np.maximum(0, 1 - np.square(xyz).sum(axis=1)))
        return unit(np.column_stack([w, xyz]))
    words = np.frombuffer(packed.rotations.tobytes(), "<u4")
    shifts = np.uint32(TURN_BITS + 1) * np.array([2, 1, 0], np.uint32)
    parts = words[:, None] >> shifts
    most = np.uint32((1 << TURN_BITS) - 1)
    signs = np.where(parts >> np.uint32(TURN_BITS) & np.uint32(1), -1, 1)
    others = signs * (parts & most) * (HALF / float(most))
    return np.roll(from_smallest_three(words >> np.uint32(30), others), 1, axis=1)
