"""The common 3D Gaussian splatting PLY: what every viewer opens, written strictly, read kindly."""

from __future__ import annotations

import json
import re

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.errors import InputError
from styl3r_cli.formats.ply_container import Table, read_vertices
from styl3r_cli.formats.scene import Encoded, Scene
from styl3r_cli.gaussians import Gaussians

# The order of the first 3DGS implementation (Kerbl et al. 2023); some viewers rely on it.
MEANS = ("x", "y", "z")
NORMALS = ("nx", "ny", "nz")  # unused, but expected by some viewers: zeros
COLOURS = ("f_dc_0", "f_dc_1", "f_dc_2")
SCALES = ("scale_0", "scale_1", "scale_2")
ROTATIONS = ("rot_0", "rot_1", "rot_2", "rot_3")
PROPERTIES = (*MEANS, *NORMALS, *COLOURS, "opacity", *SCALES, *ROTATIONS)
REQUIRED = tuple(name for name in PROPERTIES if name not in NORMALS)

SH_C0 = 0.28209479177387814  # the constant spherical harmonic, 1 / (2 sqrt(pi))
# sigmoid(18) is 1 in float32 and every float32 below 1 has a smaller logit, so 1 comes back as 1;
# 0 comes back as 1.5e-8, which no renderer draws; and no viewer meets an infinity.
LOGIT_LIMIT = 18.0
# Far below a pixel in any scene, far above where float32 covariances (squares) underflow.
SMALLEST_SCALE = 1e-10
COLOUR_LIMIT = 1e37  # so that division by SH_C0 stays in float32

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
    kept, dropped = _finite_only(gaussians, notes)
    columns = _stored(kept)
    flat = int((kept.scales < SMALLEST_SCALE).any(axis=1).sum())
    if flat:
        notes.append(f"{flat} Gaussians were flatter than {SMALLEST_SCALE:g} and made so thick")
    return Encoded(_header(len(kept), metadata) + columns.tobytes(), len(kept), dropped, notes)


def decode(data: bytes, name: str) -> Scene:
    """Read any 3DGS PLY: ASCII or binary, either byte order, properties in any order and type.

    View-dependent colours (`f_rest_*`), normals and unknown properties and elements are ignored;
    rotations need not be unit quaternions.

    Args:
        data: the whole file.
        name: what to call it in messages.

    Raises:
        InputError: it is no PLY, is damaged, or holds something other than 3D Gaussians.
    """
    table = read_vertices(data, name)
    _require_gaussians(table, name)
    notes: list[str] = []
    if any(name.startswith("f_rest_") and table.column(name).any() for name in table.names):
        notes.append("view-dependent colours (f_rest) are ignored")
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is dropped just below
        gaussians = Gaussians(
            means=_columns(table, MEANS).astype(np.float32),
            scales=np.exp(_columns(table, SCALES)).astype(np.float32),
            rotations=_unit(_columns(table, ROTATIONS)).astype(np.float32),
            opacities=_sigmoid(table.column("opacity")).astype(np.float32),
            colours=(0.5 + SH_C0 * _columns(table, COLOURS)).astype(np.float32),
        )
    kept, dropped = _finite_only(gaussians, notes)
    return Scene(kept, _metadata(table.comments), notes, dropped)


def _stored(gaussians: Gaussians) -> NDArray[np.float32]:
    """(G, 17) values in the file's order."""
    colours = gaussians.colours.clip(-COLOUR_LIMIT, COLOUR_LIMIT).astype(np.float64)
    columns = np.zeros((len(gaussians), len(PROPERTIES)), "<f4")
    columns[:, 0:3] = gaussians.means
    columns[:, 6:9] = (colours - 0.5) / SH_C0
    columns[:, 9] = _logit(gaussians.opacities)
    columns[:, 10:13] = np.log(np.maximum(gaussians.scales, SMALLEST_SCALE, dtype=np.float64))
    columns[:, 13:17] = _unit(gaussians.rotations)
    return columns


def _header(count: int, metadata: dict[str, str]) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0"]
    for key, value in metadata.items():
        # JSON's escapes keep line ends and other alphabets out of an ASCII header.
        line = f"{key}: {json.dumps(value)[1:-1]}"
        if not _COMMENT.fullmatch(line):
            raise ValueError(f"not a metadata key: {key!r}")
        lines.append(f"comment {line}")
    lines.append(f"element vertex {count}")
    lines += [f"property float {name}" for name in PROPERTIES]
    lines.append("end_header\n")
    return "\n".join(lines).encode("ascii")


def _metadata(comments: list[str]) -> dict[str, str]:
    metadata = {}
    for comment in comments:
        match = _COMMENT.fullmatch(comment)
        if match:
            key, value = match.groups()
            try:
                metadata[key] = json.loads(f'"{value}"')
            except json.JSONDecodeError:
                metadata[key] = value  # another program's comment
    return metadata


def _require_gaussians(table: Table, name: str) -> None:
    missing = [wanted for wanted in REQUIRED if wanted not in table.names]
    if not missing:
        return
    if "packed_position" in table.names:
        raise InputError(f"{name}: a compressed PLY; convert it to a plain PLY first")
    kind = "a point cloud or mesh" if set(MEANS) <= set(table.names) else "a PLY of something else"
    raise InputError(f"{name}: {kind}, not 3D Gaussians: it has no {', '.join(missing)}")


def _columns(table: Table, names: tuple[str, ...]) -> NDArray[np.float64]:
    return np.stack([table.column(name).astype(np.float64) for name in names], axis=1)


def _finite_only(gaussians: Gaussians, notes: list[str]) -> tuple[Gaussians, int]:
    finite = np.isfinite(gaussians.opacities)
    for array in (gaussians.means, gaussians.scales, gaussians.rotations, gaussians.colours):
        finite &= np.isfinite(array).all(axis=1)
    dropped = int(len(finite) - finite.sum())
    if not dropped:
        return gaussians, 0
    notes.append(f"{dropped} of {len(finite)} Gaussians were not finite and left out")
    return gaussians.select(finite), dropped


def _logit(opacities: NDArray[np.float32]) -> NDArray[np.float64]:
    opacity = opacities.astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        logits = np.log(opacity) - np.log1p(-opacity)
    logits = np.where(opacity >= 1, LOGIT_LIMIT, np.where(opacity <= 0, -LOGIT_LIMIT, logits))
    return logits.clip(-LOGIT_LIMIT, LOGIT_LIMIT)


def _sigmoid(logits: NDArray[np.generic]) -> NDArray[np.float64]:
    return 1 / (1 + np.exp(-logits.astype(np.float64)))


def _unit(rotations: NDArray[np.floating]) -> NDArray[np.float64]:
    """Quaternions of length 1; one of length 0 turns nothing."""
    quaternions = rotations.astype(np.float64)
    length = np.linalg.norm(quaternions, axis=1, keepdims=True)
    identity = np.array([1.0, 0.0, 0.0, 0.0])
    return np.where(length > 0, quaternions / np.where(length > 0, length, 1), identity)
