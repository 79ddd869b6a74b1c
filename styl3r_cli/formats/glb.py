"""glTF (.glb) with KHR_gaussian_splatting: Gaussians for programs that know glTF.

Specification: https://github.com/KhronosGroup/glTF, extensions/2.0/Khronos/KHR_gaussian_splatting.
Scales and opacities are linear, rotations x y z w. Axes are y up, z towards whoever looks: the
first photo's camera is a glTF camera without a turn, so that viewers open the scene from its front.
Programs without the extension draw points in the Gaussians' colours (COLOR_0).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from styl3r_cli import __version__
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.stored import cameras_from_metadata
from styl3r_cli.errors import InputError
from styl3r_cli.formats.glb_container import Arrays, read_array, split
from styl3r_cli.formats.glb_nodes import Placed, placed
from styl3r_cli.formats.scene import Encoded, Scene
from styl3r_cli.formats.values import (
    check_count,
    finite_only,
    from_harmonics,
    in_float32,
    to_harmonics,
    turned,
    unit,
)
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.srgb import from_linear, to_linear

EXTENSION = "KHR_gaussian_splatting"
HARMONICS = f"{EXTENSION}:SH_DEGREE_0_COEF_0"
SRGB, LINEAR = "srgb_rec709_display", "lin_rec709_display"
PROPERTIES = {
    "kernel": "ellipse",
    "colorSpace": SRGB,
    "sortingMethod": "cameraDistance",
    "projection": "perspective",
}
POINTS = 0  # glTF's drawing mode
KEY = "styl3r"  # of asset.extras, for the metadata that this program writes along
MOST_PARTS = 1024  # each takes a millisecond, however small it is
COLOUR_LEVELS = 65535  # COLOR_0 is linear, where 8 bits would show steps in the dark


def encode(gaussians: Gaussians, metadata: dict[str, str]) -> Encoded:
    """All values as float32; the views as glTF cameras, and metadata in `asset.extras`.

    Args:
        gaussians: the scene; opacities are clipped to [0, 1].
        metadata: any text.
    """
    notes: list[str] = []
    scene = finite_only(gaussians, notes)
    kept = turned(scene.gaussians)
    asset: dict[str, Any] = {"version": "2.0", "generator": f"styl3r {__version__}"}
    if metadata:
        asset["extras"] = {KEY: metadata}
    cameras = cameras_from_metadata(metadata)
    document: dict[str, Any] = {"asset": asset, "scene": 0}
    arrays = Arrays()
    if len(kept):
        document["extensionsUsed"] = [EXTENSION]
        document["meshes"] = [{"name": "Gaussians", "primitives": [_primitive(kept, arrays)]}]
    nodes: list[dict[str, Any]] = [{"name": "scene", "mesh": 0}] if len(kept) else []
    if cameras:
        document["cameras"] = [_lens(camera) for camera in cameras]
        nodes += [_camera_node(index, camera) for index, camera in enumerate(cameras)]
    document["scenes"] = [{"nodes": list(range(len(nodes)))}] if nodes else [{}]
    if nodes:
        document["nodes"] = nodes
    return Encoded(arrays.bundle(document), len(kept), scene.dropped, notes)


def decode(data: bytes, name: str) -> Scene:
    """Read every primitive with the extension, where the default scene places it.

    View-dependent colours are ignored.

    Args:
        data: the whole file.
        name: what to call it in messages.

    Raises:
        InputError: it is no .glb, is damaged, or holds no Gaussians.
    """
    document, binary = split(data, name)
    try:
        asset = document.get("asset")
        metadata = _metadata(asset)
        notes: list[str] = []
        parts, count = list[Gaussians](), 0
        for place in _splats(document):
            parts.append(_read(document, binary, place, notes))
            # Nodes may share a mesh: a few kilobytes of them would be billions of Gaussians.
            count += len(parts[-1])
            check_count(count, len(data), name)
            if len(parts) > MOST_PARTS:
                raise ValueError(f"its Gaussians are in more than {MOST_PARTS} parts")
    except InputError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError) as error:
        raise InputError(f"{name}: damaged: {str(error)[:80] or type(error).__name__}") from error
    own = isinstance(asset, dict) and str(asset.get("generator", "")).startswith("styl3r ")
    if not parts and not (own and not document.get("meshes")):
        raise InputError(f"{name}: a .glb without Gaussians ({EXTENSION})")
    fields = Gaussians.__dataclass_fields__
    if parts:
        whole = {key: np.concatenate([getattr(part, key) for part in parts]) for key in fields}
    else:
        shapes = {"rotations": (0, 4), "opacities": (0,)}
        whole = {key: np.zeros(shapes.get(key, (0, 3)), np.float32) for key in fields}
    kept = finite_only(turned(Gaussians(**whole)), notes)
    return Scene(kept.gaussians, metadata, notes, kept.dropped, kept.non_finite)


def _primitive(gaussians: Gaussians, arrays: Arrays) -> dict[str, Any]:
    opacities = gaussians.opacities.clip(0, 1)
    colours = np.column_stack([to_linear(gaussians.colours), opacities])
    rotations = np.roll(unit(gaussians.rotations), -1, axis=1).astype("<f4")
    attributes = {
        "POSITION": arrays.add(gaussians.means, bounds=True),
        "COLOR_0": arrays.add(np.rint(colours * COLOUR_LEVELS).astype("<u2"), normalised=True),
        f"{EXTENSION}:ROTATION": arrays.add(rotations),
        f"{EXTENSION}:SCALE": arrays.add(gaussians.scales),
        f"{EXTENSION}:OPACITY": arrays.add(opacities),
        HARMONICS: arrays.add(to_harmonics(gaussians.colours).astype("<f4")),
    }
    return {"attributes": attributes, "mode": POINTS, "extensions": {EXTENSION: PROPERTIES}}


def _lens(camera: Camera) -> dict[str, Any]:
    """A glTF camera; a principal point away from the centre is in the metadata only."""
    lens = {
        "yfov": 2 * float(np.arctan(camera.height / 2 / camera.fy)),
        "aspectRatio": (camera.width / camera.fx) / (camera.height / camera.fy),
        "znear": 0.01,  # required; Gaussians are drawn from there on in any viewer
    }
    return {"type": "perspective", "perspective": lens}


def _camera_node(index: int, camera: Camera) -> dict[str, Any]:
    flip = np.diag([1.0, -1, -1, 1])  # both of the world's axes and the camera's
    matrix = flip @ np.linalg.inv(camera.extrinsics) @ flip
    return {"name": f"view {index + 1}", "camera": index, "matrix": matrix.T.ravel().tolist()}


def _metadata(asset: object) -> dict[str, str]:
    extras = asset.get("extras") if isinstance(asset, dict) else None
    own = extras.get(KEY) if isinstance(extras, dict) else None
    if not isinstance(own, dict):
        return {}
    return {key: value for key, value in own.items() if isinstance(value, str)}


def _splats(document: dict[str, Any]) -> Iterator[Placed]:
    """The primitives with the extension, and where the default scene places them."""
    for place in placed(document):
        if EXTENSION in place.primitive.get("extensions", {}):
            yield place


def _read(
    document: dict[str, Any], binary: memoryview, place: Placed, notes: list[str]
) -> Gaussians:
    attributes = place.primitive["attributes"]
    properties = place.primitive["extensions"][EXTENSION]
    if HARMONICS not in attributes:
        raise ValueError("its Gaussians have no degree-0 harmonics, or are compressed")

    def array(key: str, width: int = 3) -> NDArray[np.float64]:
        values = read_array(document, binary, attributes[key])
        if values.shape[1] != width:
            raise ValueError(f"'{key}' has {values.shape[1]} instead of {width} numbers")
        return values.astype(np.float64)

    if any(":SH_DEGREE_" in key and key != HARMONICS for key in attributes):
        notes.append("view-dependent colours are ignored")
    colours = from_harmonics(array(HARMONICS))
    if properties.get("colorSpace", SRGB) == LINEAR:
        notes.append("colours to be blended in linear light were made sRGB, and blend as such")
        colours = from_linear(colours)
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is dropped afterwards
        gaussians = in_float32(
            means=array("POSITION"),
            scales=np.abs(array(f"{EXTENSION}:SCALE")),
            rotations=unit(np.roll(array(f"{EXTENSION}:ROTATION", 4), 1, axis=1)),
            opacities=array(f"{EXTENSION}:OPACITY", 1)[:, 0].clip(0, 1),
            colours=colours,
        )
        return place.moved(gaussians)
