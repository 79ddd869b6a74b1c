"""SuperSplat's compressed PLY: 16 bytes a Gaussian, in chunks of 256 with ranges of their own.

Layout: https://blog.playcanvas.com/compressing-gaussian-splats, with the colour ranges that
SuperSplat 2 added; checked against PlayCanvas's splat-transform.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.errors import InputError
from styl3r_cli.formats import ply
from styl3r_cli.formats.ply_container import Table, read_element
from styl3r_cli.formats.quantise import (
    HALF,
    from_smallest_three,
    morton_order,
    smallest_three,
    to_levels,
)
from styl3r_cli.formats.scene import Encoded, Scene
from styl3r_cli.formats.values import finite_only, in_float32, thickened, unit
from styl3r_cli.gaussians import Gaussians

CHUNK = 256  # Gaussians that share ranges
MEAN_RANGE = ("min_x", "min_y", "min_z", "max_x", "max_y", "max_z")
SCALE_RANGE = tuple(f"{end}_scale_{axis}" for end in ("min", "max") for axis in "xyz")
COLOUR_RANGE = tuple(f"{end}_{channel}" for end in ("min", "max") for channel in "rgb")
RANGES = (*MEAN_RANGE, *SCALE_RANGE, *COLOUR_RANGE)
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
# Bits of each part of a word, from the highest down.
VECTOR, ROTATION, COLOUR = (11, 10, 11), (2, 10, 10, 10), (8, 8, 8, 8)
SMALLEST_LOG = -20.0  # readers clip here: 2e-9 is far below a pixel, and empties no chunk's range
LOSS = (
    "a compressed PLY rounds: means and scales to 10 and 11 bits of their chunk's range, "
    "rotations to 10 bits, colours and opacities to 8; Gaussians are sorted along a curve in space"
)


def encode(gaussians: Gaussians, metadata: dict[str, str]) -> Encoded:
    """Chunks of neighbours in space; metadata in comments, as in a plain PLY.

    Args:
        gaussians: the scene.
        metadata: keys of letters, digits, `_`, `.` and `-`; any text as values.
    """
    notes: list[str] = []
    scene = finite_only(gaussians, notes)
    kept = scene.gaussians.select(morton_order(scene.gaussians.means))
    notes += [LOSS, *thickened(kept.scales, float(np.exp(SMALLEST_LOG)))]
    logs = np.log(np.maximum(kept.scales, np.exp(SMALLEST_LOG), dtype=np.float64))
    means, mean_range = _within_chunks(kept.means)
    scales, scale_range = _within_chunks(logs)
    colours, colour_range = _within_chunks(kept.colours)
    largest, others = smallest_three(unit(kept.rotations))
    words = np.empty((len(kept), len(PACKED)), "<u4")
    words[:, 0] = _pack([to_levels(means[:, i], _top(VECTOR[i])) for i in range(3)], VECTOR)
    turns = to_levels(others / HALF / 2 + 0.5, _top(ROTATION[1]))
    words[:, 1] = _pack([largest.astype(np.uint32), *turns.T], ROTATION)
    words[:, 2] = _pack([to_levels(scales[:, i], _top(VECTOR[i])) for i in range(3)], VECTOR)
    bytes_ = to_levels(np.column_stack([colours, kept.opacities]), _top(COLOUR[0]))
    words[:, 3] = _pack(list(bytes_.T), COLOUR)
    chunks = np.column_stack([mean_range, scale_range, colour_range]).astype("<f4")
    lines = [f"element chunk {len(chunks)}", *(f"property float {name}" for name in RANGES)]
    lines += [f"element vertex {len(words)}", *(f"property uint {name}" for name in PACKED)]
    data = ply.header(metadata, lines) + chunks.tobytes() + words.tobytes()
    return Encoded(data, len(kept), scene.dropped, notes)


def decode(data: bytes, name: str) -> Scene:
    """Read a compressed or a plain PLY: programs give both either name."""
    return ply.decode(data, name)


def decode_packed(data: bytes, name: str) -> Scene:
    """Read a PLY that is known to be compressed; its view-dependent colours are ignored.

    Args:
        data: the whole file.
        name: what to call it in messages.

    Raises:
        InputError: it is damaged, or packed in another way.
    """
    vertices, chunks = read_element(data, name), read_element(data, name, "chunk")
    _require(vertices, PACKED, name)
    _require(chunks, (*MEAN_RANGE, *SCALE_RANGE), name)
    words = {key: vertices.column(key).astype(np.uint32) for key in PACKED}
    chunk = np.arange(len(vertices.rows)) // CHUNK
    if len(chunk) and len(chunks.rows) <= chunk[-1]:
        raise InputError(f"{name}: damaged: {len(chunks.rows)} chunks for {len(chunk)} Gaussians")
    notes: list[str] = []
    if b"\nelement sh " in data[: data.index(b"end_header")]:
        notes.append("view-dependent colours (sh) are ignored")
    largest, *turns = _unpack(words["packed_rotation"], ROTATION)
    others = (np.stack(turns, axis=1) / _top(ROTATION[1]) - 0.5) * 2 * HALF
    colours = _unit_interval(words["packed_color"], COLOUR)
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is dropped just below
        means = _in_range(_unit_interval(words["packed_position"], VECTOR), chunks, MEAN_RANGE)
        scales = _in_range(_unit_interval(words["packed_scale"], VECTOR), chunks, SCALE_RANGE)
        rgb = colours[:, :3]
        if set(COLOUR_RANGE) <= set(chunks.names):
            rgb = _in_range(rgb, chunks, COLOUR_RANGE)
        gaussians = in_float32(
            means=means,
            scales=np.exp(scales),
            rotations=from_smallest_three(largest, others),
            opacities=colours[:, 3],
            colours=rgb,
        )
    kept = finite_only(gaussians, notes)
    metadata = ply.metadata_of(vertices.comments)
    return Scene(kept.gaussians, metadata, notes, kept.dropped, kept.non_finite)


def _within_chunks(values: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """(G, 3) values as fractions of their chunk's range, and (chunks, 6) the ranges as stored."""
    starts = np.arange(0, len(values), CHUNK)
    if not len(starts):
        return np.zeros((0, 3)), np.zeros((0, 6), np.float32)
    low = np.minimum.reduceat(values, starts).astype(np.float32)
    high = np.maximum.reduceat(values, starts).astype(np.float32)
    chunk = np.arange(len(values)) // CHUNK
    width = high.astype(np.float64) - low
    fractions = (values - low[chunk].astype(np.float64)) / np.where(width > 0, width, 1)[chunk]
    return fractions, np.column_stack([low, high])


def _in_range(
    fractions: NDArray[np.float64], chunks: Table, names: tuple[str, ...]
) -> NDArray[np.float64]:
    """The inverse of `_within_chunks`."""
    ends = np.stack([chunks.column(name).astype(np.float64) for name in names], axis=1)
    low, high = np.repeat(ends, CHUNK, axis=0)[: len(fractions)].reshape(-1, 2, 3).swapaxes(0, 1)
    return low + fractions * (high - low)


def _pack(parts: list[NDArray[np.uint32]], bits: tuple[int, ...]) -> NDArray[np.uint32]:
    word = np.zeros(len(parts[0]), np.uint32)
    for part, width in zip(parts, bits, strict=True):
        word = (word << np.uint32(width)) | part
    return word


def _unpack(words: NDArray[np.uint32], bits: tuple[int, ...]) -> list[NDArray[np.uint32]]:
    parts = []
    for width in reversed(bits):
        parts.append(words & np.uint32(_top(width)))
        words = words >> np.uint32(width)
    return parts[::-1]


def _unit_interval(words: NDArray[np.uint32], bits: tuple[int, ...]) -> NDArray[np.float64]:
    """A word's parts as columns in [0, 1]."""
    parts = zip(_unpack(words, bits), bits, strict=True)
    return np.stack([part / _top(width) for part, width in parts], axis=1)


def _top(bits: int) -> int:
    return (1 << bits) - 1


def _require(table: Table, wanted: tuple[str, ...], name: str) -> None:
    missing = [key for key in wanted if key not in table.names]
    if missing:
        raise InputError(f"{name}: a compressed PLY of another kind: no {', '.join(missing)}")
