"""glTF with Gaussians: as the extension says, and for trimesh as for anyone else's reader."""

from __future__ import annotations

import io
import json
import struct

import numpy as np
import pytest
import trimesh
from test_round_trips import cameras, scene_of

from styl3r_cli.cameras.stored import cameras_from_metadata
from styl3r_cli.formats import encode_scene, read_scene
from styl3r_cli.formats.glb_nodes import to_matrices, to_quaternions
from styl3r_cli.formats.points_glb import LEAST_OPACITY
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.srgb import from_linear

FLIP = np.diag([1.0, -1.0, -1.0])  # OpenCV's axes to glTF's, and back


def parts(data: bytes) -> tuple[dict, dict[str, np.ndarray]]:
    """The document, and its first primitive's attributes, by nothing of ours."""
    length = struct.unpack_from("<I", data, 12)[0]
    document, binary = json.loads(data[20 : 20 + length]), data[28 + length :]
    attributes = {}
    for key, index in document["meshes"][0]["primitives"][0]["attributes"].items():
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        kind = {5126: "<f4", 5123: "<u2"}[accessor["componentType"]]
        assert view["byteOffset"] % 4 == 0
        values = np.frombuffer(binary, kind, accessor["count"] * width, view["byteOffset"])
        attributes[key.removeprefix("KHR_gaussian_splatting:")] = values.reshape(-1, width)
    return document, attributes


def covariances(rotations: np.ndarray, scales: np.ndarray) -> np.ndarray:
    axes = to_matrices(rotations) * scales[:, None, :]
    return axes @ axes.swapaxes(1, 2)


def rebuilt(data: bytes, change: dict[str, object]) -> bytes:
    """The same file with other things in its first node."""
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    document["nodes"][0] |= change
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    head = struct.pack("<IIIII", 0x46546C67, 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    return head + text + rest


def test_the_attributes_are_the_extensions() -> None:
    scene = scene_of(40)
    document, stored = parts(encode_scene(scene, {}, ".glb").data)
    assert document["extensionsUsed"] == ["KHR_gaussian_splatting"]
    primitive = document["meshes"][0]["primitives"][0]
    assert primitive["mode"] == 0
    assert primitive["extensions"]["KHR_gaussian_splatting"]["colorSpace"] == "srgb_rec709_display"
    np.testing.assert_array_equal(stored["POSITION"], scene.means @ FLIP.astype(np.float32))
    np.testing.assert_array_equal(stored["SCALE"], scene.scales)
    np.testing.assert_array_equal(stored["OPACITY"][:, 0], scene.opacities)
    colours = 0.5 + stored["SH_DEGREE_0_COEF_0"] / np.sqrt(4 * np.pi)
    np.testing.assert_allclose(colours, scene.colours, atol=1e-6)
    wxyz = np.roll(stored["ROTATION"], 1, axis=1)
    np.testing.assert_allclose(
        covariances(wxyz, stored["SCALE"]),
        FLIP @ covariances(scene.rotations, scene.scales) @ FLIP,
        atol=1e-7,
    )
    position = document["accessors"][primitive["attributes"]["POSITION"]]
    np.testing.assert_allclose(position["min"], stored["POSITION"].min(axis=0))
    np.testing.assert_allclose(position["max"], stored["POSITION"].max(axis=0))


def test_who_knows_no_gaussians_sees_points_in_their_colours() -> None:
    scene = scene_of(60)
    data = encode_scene(scene, cameras(), ".glb").data
    [points] = trimesh.load(io.BytesIO(data), file_type="glb").geometry.values()
    np.testing.assert_allclose(points.vertices, scene.means @ FLIP, atol=1e-6)
    _, stored = parts(data)
    linear = stored["COLOR_0"] / 65535
    np.testing.assert_allclose(from_linear(linear[:, :3]), scene.colours, atol=2e-4)
    np.testing.assert_allclose(linear[:, 3], scene.opacities, atol=1e-5)


def test_the_views_are_gltf_cameras() -> None:
    document, _ = parts(encode_scene(scene_of(3), cameras(), ".glb").data)
    [view, _] = cameras_from_metadata(cameras())
    node = next(node for node in document["nodes"] if "camera" in node)
    placed = np.reshape(node["matrix"], (4, 4)).T
    np.testing.assert_allclose(placed[:3, 3], FLIP @ np.linalg.inv(view.extrinsics)[:3, 3])
    ahead = placed @ [0, 0, -2, 1]  # glTF cameras look along -z
    np.testing.assert_allclose(
        ahead[:3], FLIP @ (np.linalg.inv(view.extrinsics) @ [0, 0, 2, 1])[:3]
    )
    lens = document["cameras"][0]["perspective"]
    assert lens["yfov"] == pytest.approx(2 * np.arctan(254 / 2 / 201))


@pytest.mark.parametrize(
    "change",
    [
        {"translation": [1, 2, 3], "rotation": [0.5, 0.5, -0.5, 0.5], "scale": [2, 2, 2]},
        {"scale": [1, -3, 0.5]},
        {"matrix": [1, 0.5, 0, 0, 0, 2, 0.25, 0, 0.5, 0, 1, 0, 4, 5, 6, 1]},
    ],
)
def test_nodes_place_gaussians_as_they_place_points(change: dict[str, object]) -> None:
    scene = scene_of(30)
    data = rebuilt(encode_scene(scene, {}, ".glb").data, change)
    theirs = trimesh.load(io.BytesIO(data), file_type="glb")
    name = theirs.graph.nodes_geometry[0]
    matrix = theirs.graph.get(name)[0]
    back = read_scene(data).gaussians
    means = trimesh.transform_points(scene.means @ FLIP, matrix) @ FLIP
    np.testing.assert_allclose(back.means, means, atol=1e-5)
    linear = FLIP @ matrix[:3, :3] @ FLIP
    np.testing.assert_allclose(
        covariances(back.rotations, back.scales),
        linear @ covariances(scene.rotations, scene.scales) @ linear.T,
        atol=1e-5,
    )


def test_rotations_and_matrices() -> None:
    quaternions = scene_of(500).rotations.astype(np.float64)
    quaternions = np.vstack([quaternions, np.eye(4)])
    matrices = to_matrices(quaternions)
    back = to_quaternions(matrices)
    signs = np.sign((back * quaternions).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(back * signs, quaternions, atol=1e-6)


def test_points_and_frusta_for_programs_without_gaussians() -> None:
    scene = scene_of(80)
    encoded = encode_scene(scene, cameras(), ".points.glb")
    loaded = trimesh.load(io.BytesIO(encoded.data), file_type="glb")
    visible = scene.opacities >= LEAST_OPACITY
    assert encoded.count == visible.sum() < 80
    points = loaded.geometry["points"]
    np.testing.assert_allclose(points.vertices, scene.means[visible] @ FLIP, atol=1e-6)
    colours = from_linear(np.asarray(points.colors)[:, :3] / 255)
    # 8 bits of linear light: the darkest step is 13 of sRGB's
    np.testing.assert_allclose(colours, scene.colours[visible], atol=0.026)
    [view, _] = cameras_from_metadata(cameras())
    frustum = loaded.geometry["view 1"]
    corners = np.unique(np.asarray(frustum.vertices).round(6), axis=0) @ FLIP
    local = corners @ view.extrinsics[:3, :3].T + view.extrinsics[:3, 3]
    assert len(local) == 5
    ahead = local[local[:, 2] > 1e-4]
    pixels = ahead[:, :2] / ahead[:, 2:] * [view.fx, view.fy] + [view.cx, view.cy]
    expected = {(0, 0), (256, 0), (256, 254), (0, 254)}
    assert {tuple(map(int, pixel.round())) for pixel in pixels} == expected


def test_no_points_and_no_cameras_is_a_file_too() -> None:
    faint = scene_of(5)
    faint = Gaussians(faint.means, faint.scales, faint.rotations, np.zeros(5), faint.colours)
    for scene in (faint, scene_of(0)):
        assert encode_scene(scene, {}, ".points.glb").count == 0
        assert encode_scene(scene, cameras(), ".points.glb").count == 0
