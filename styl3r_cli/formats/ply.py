"""The common 3D Gaussian splatting PLY: what every viewer opens, written strictly, read kindly."""

from __future__ import annotations

import json
import re
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.errors import InputError
from styl3r_cli.formats.ply_container import Table, read_element
from styl3r_cli.formats.scene import Encoded, Scene
from styl3r_cli.formats.values import (
    SMALLEST_SCALE,
    finite_only,
    from_harmonics,
    in_float32,
    logit,
    rounded,
    sigmoid,
    thickened,
    to_harmonics,
    unit,
)
from styl3r_cli.gaussians import Gaussians

# The order of the first 3DGS implementation (Kerbl et al. 2023); some viewers rely on it.
MEANS = ("x", "y", "z")
NORMALS = ("nx", "ny", "nz")  # unused, but expected by some viewers: zeros
COLOURS = ("f_dc_0", "f_dc_1", "f_dc_2")
SCALES = ("scale_0", "scale_1", "scale_2")
ROTATIONS = ("rot_0", "rot_1", "rot_2", "rot_3")
PROPERTIES = (*MEANS, *NORMALS, *COLOURS, "opacity", *SCALES, *ROTATIONS)
FILTER = "filter_3D"  # Mip-Splatting's smoothing (Yu et al. 2024), which it keeps apart
REQUIRED = tuple(name for name in PROPERTIES if name not in NORMALS)

_COMMENT = re.compile(r"([A-Za-z0-9_.-]+): (.*)", re.DOTALL)


def encode(gaussians: Gaussians, metadata: dict[str, str]) -> Encoded:
    """Binary little endian, one `vertex` element, float32 properties, metadata in comments.

    Opacities are stored as logits, scales as natural logarithms, rotations as unit quaternions
    w x y z, colours as degree-0 spherical harmonics. Gaussians with a value that is not finite are
    left out.

    Args:
        gaussians: the scene.
        metadata: keys of letters, digits, `_`, `.` and `-`; any text as values.
    """
    notes: list[str] = []
    kept = finite_only(gaussians, notes)
    columns = _stored(kept.gaussians)
    notes += thickened(kept.gaussians.scales, SMALLEST_SCALE)
    lines = [f"element vertex {len(columns)}", *(f"property float {name}" for name in PROPERTIES)]
    data = header(metadata, lines) + columns.tobytes()
    return Encoded(data, len(columns), kept.dropped, notes)


def decode(data: bytes, name: str) -> Scene:
    """Read any 3DGS PLY: ASCII or binary, either byte order, properties in any order and type.

    Mip-Splatting's smoothing filter becomes part of scales and opacities, as its renderer has it.
    View-dependent colours (`f_rest_*`), normals and unknown properties and elements are ignored;
    rotations need not be unit quaternions. A compressed PLY is recognised and read as such.

    Args:
        data: the whole file.
        name: what to call it in messages.

    Raises:
        InputError: it is no PLY, is damaged, or holds something other than 3D Gaussians.
    """
    table = read_element(data, name)
    if "packed_position" in table.names:
        from styl3r_cli.formats.compressed_ply import decode_packed

        return decode_packed(data, name)
    _require_gaussians(table, name)
    means = _columns(table, MEANS)
    notes = rounded(means)
    if table.surplus:
        notes.append("more follows the last Gaussian that its header counts, and is left out")
    if any(name.startswith("f_rest_") and table.column(name).any() for name in table.names):
        notes.append("view-dependent colours (f_rest) are ignored")
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is dropped just below
        scales, opacities = _smoothed(
            np.exp(_columns(table, SCALES)), sigmoid(table.column("opacity")), table
        )
        gaussians = in_float32(
            means=means,
            scales=scales,
            rotations=unit(_columns(table, ROTATIONS)),
            opacities=opacities,
            colours=from_harmonics(_columns(table, COLOURS)),
        )
    kept = finite_only(gaussians, notes)
    metadata = metadata_of(table.comments)
    return Scene(kept.gaussians, metadata, notes, kept.dropped, kept.non_finite)


def header(metadata: dict[str, str], lines: list[str]) -> bytes:
    """A PLY header with metadata as comments and the lines that describe the elements."""
    whole = ["ply", "format binary_little_endian 1.0"]
    for key, value in metadata.items():
        # JSON's escapes keep line ends and other alphabets out of an ASCII header.
        line = f"{key}: {json.dumps(value)[1:-1]}"
        if not _COMMENT.fullmatch(line):
            raise ValueError(f"not a metadata key: {key!r}")
        whole.append(f"comment {line}")
    return "\n".join([*whole, *lines, "end_header\n"]).encode("ascii")


def metadata_of(comments: list[str]) -> dict[str, str]:
    """The inverse of what `header` does to metadata; other programs' comments as they are.

    Of a key with several values all are told, which makes a camera none: which is meant?
    """
    metadata: dict[str, list[str]] = {}
    for comment in comments:
        match = _COMMENT.fullmatch(comment)
        if match:
            key, value = match.groups()
            with suppress(json.JSONDecodeError):  # another program's comment
                value = json.loads(f'"{value}"')
            values = metadata.setdefault(key, [])
            if values[-1:] != [value]:
                values.append(value)
    return {key: "; ".join(values) for key, values in metadata.items()}


def _stored(gaussians: Gaussians) -> NDArray[np.float32]:
    """(G, 17) values in the file's order."""
    columns = np.zeros((len(gaussians), len(PROPERTIES)), "<f4")
    columns[:, 0:3] = gaussians.means
    columns[:, 6:9] = to_harmonics(gaussians.colours)
    columns[:, 9] = logit(gaussians.opacities)
    columns[:, 10:13] = np.log(np.maximum(gaussians.scales, SMALLEST_SCALE, dtype=np.float64))
    columns[:, 13:17] = unit(gaussians.rotations)
    return columns


def _smoothed(
    scales: NDArray[np.float64], opacities: NDArray[np.float64], table: Table
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(G, 3) scales and (G,) opacities after the filter: each is wider, and as much fainter."""
    if FILTER not in table.names:
        return scales, opacities
    wider = np.hypot(scales, table.column(FILTER).astype(np.float64)[:, None])
    shares = np.divide(scales, wider, out=np.ones_like(scales), where=wider != 0)
    return wider, opacities * shares.prod(axis=1)


def _require_gaussians(table: Table, name: str) -> None:
    missing = [wanted for wanted in REQUIRED if wanted not in table.names]
    if missing:
        kind = ""  # other Gaussians, such as flat ones, which have two scales
        if "opacity" in missing:
            points = set(MEANS) <= set(table.names)
            kind = "a point cloud or mesh, " if points else "a PLY of something else, "
        lacks = ", ".join(missing)
        raise InputError(f"{name}: {kind}not 3D Gaussians: it has no {lacks}")


def _columns(table: Table, names: tuple[str, ...]) -> NDArray[np.float64]:
    return np.stack([table.column(name).astype(np.float64) for name in names], axis=1)
