"""Damaged and hostile files of every format: one clear line, no traceback, no memory spent."""

from __future__ import annotations

import gzip
import io
import json
import struct
import tracemalloc
import warnings
import zipfile
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from test_round_trips import READABLE, cameras, scene_of

from styl3r_cli.errors import InputError
from styl3r_cli.formats import MODULES, encode_scene, read_scene
from styl3r_cli.formats.splat import ROW

SMALL = {suffix: encode_scene(scene_of(30), cameras(), suffix).data for suffix in MODULES}
MOST_MEMORY = 50e6  # bytes, for a lie in a file of a few kilobytes


def refused(data: bytes, suffix: str, words: str = ".") -> None:
    """An InputError of one line that names the file, and hardly any memory on the way to it."""
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=words) as caught:
            read_scene(data, suffix)
        assert tracemalloc.get_traced_memory()[1] < MOST_MEMORY
    finally:
        tracemalloc.stop()
    message = str(caught.value)
    assert message.startswith("-: ")
    assert "\n" not in message
    assert len(message) < 200


def read_or_refused(data: bytes, suffix: str) -> None:
    try:
        gaussians = read_scene(data, suffix).gaussians
    except InputError:
        return
    for array in (gaussians.means, gaussians.scales, gaussians.rotations, gaussians.colours):
        assert np.isfinite(array).all()


@pytest.mark.parametrize("suffix", MODULES)
def test_cut_off_anywhere(suffix: str) -> None:
    whole = SMALL[suffix]
    for end in {*range(0, len(whole), max(1, len(whole) // 60)), *range(12), len(whole) - 1}:
        read_or_refused(whole[:end], suffix)
    if suffix != ".splat":
        refused(whole[: len(whole) // 2], suffix)
    refused(b"", suffix, "empty")
    refused(b"this is no scene at all", suffix, r"not a|no|cut off")


@given(st.sampled_from(READABLE), st.data())
@settings(max_examples=300, deadline=None)
def test_changed_bytes_are_read_or_refused(suffix: str, draw: st.DataObject) -> None:
    data = bytearray(SMALL[suffix])
    for _ in range(draw.draw(st.integers(1, 4))):
        place = draw.draw(st.integers(0, len(data) - 1))
        data[place] = draw.draw(st.integers(0, 255))
    read_or_refused(bytes(data), suffix)


@given(st.sampled_from([".spz", ".sog", ".glb"]), st.binary(max_size=300))
@settings(max_examples=100, deadline=None)
def test_a_right_beginning_and_then_anything(suffix: str, rest: bytes) -> None:
    read_or_refused(SMALL[suffix][:20] + rest, suffix)


@pytest.mark.parametrize("field", [0, 4, 8, 12, 13])
@pytest.mark.parametrize("value", [0xFFFFFFFF, 0x7FFFFFFF, 100_000_000, 31])
def test_spz_headers_that_lie(field: int, value: int) -> None:
    body = bytearray(gzip.decompress(SMALL[".spz"]))
    body[field : field + 4] = struct.pack("<I", value) if field < 12 else bytes([value & 255]) * 4
    read_or_refused(gzip.compress(bytes(body)), ".spz")
    if field == 8 and value > 31:
        refused(gzip.compress(bytes(body)), ".spz", f"claims {value} Gaussians in")


def test_a_bomb_of_zeros_is_not_unpacked() -> None:
    bomb = gzip.compress(struct.pack("<IIIBBBB", 0x5053474E, 3, 10**9, 0, 12, 0, 0) + bytes(10**7))
    refused(bomb, ".spz", "claims 1000000000 Gaussians")
    longer = gzip.compress(gzip.decompress(SMALL[".spz"]) + bytes(2 * 10**7))
    assert len(read_scene(longer, ".spz").gaussians) == 30  # what follows is not even unpacked


def changed_sog(change: Callable[[dict], object], extra: dict[str, bytes] | None = None) -> bytes:
    """The small bundle with another meta.json, or other pictures."""
    source = zipfile.ZipFile(io.BytesIO(SMALL[".sog"]))
    meta = json.loads(source.read("meta.json"))
    change(meta)
    files = {name: source.read(name) for name in source.namelist()} | (extra or {})
    files["meta.json"] = json.dumps(meta).encode()
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as target:
        for name, data in files.items():
            target.writestr(name, data)
    return buffer.getvalue()


def picture(width: int, height: int) -> bytes:
    buffer = io.BytesIO()
    Image.new("RGBA", (width, height)).save(buffer, "webp", lossless=True)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda meta: meta.update(count=10**9), "claims 1000000000 Gaussians"),
        (lambda meta: meta.update(count=10**30), "claims"),
        (lambda meta: meta.update(count=-1), "claims"),
        (lambda meta: meta.update(count=1000), "pixels for 1000 Gaussians"),
        (lambda meta: meta.update(count=1.5), "how many"),
        (lambda meta: meta.update(count=True), "how many"),
        (lambda meta: meta.update(version=1), "not SOG version 2"),
        (lambda meta: meta.pop("quats"), "picture 0 of 'quats' missing"),
        (lambda meta: meta["sh0"].update(files=["../../etc/passwd"]), "missing"),
        (lambda meta: meta["sh0"].update(files=["meta.json"]), "cannot be read as a picture"),
        (lambda meta: meta["sh0"].update(codebook=[0] * 255), "not 256 numbers"),
        (lambda meta: meta["sh0"].update(codebook=["x"] * 256), "not 256 numbers"),
        (lambda meta: meta["sh0"].update(codebook=[10**400] * 256), "not 256 numbers"),
        (lambda meta: meta["means"].update(mins=None), "not 3 numbers"),
    ],
)
def test_sog_descriptions_that_lie(change: Callable[[dict], object], words: str) -> None:
    refused(changed_sog(change), ".sog", words)


def test_sog_pictures_that_lie() -> None:
    unchanged = lambda meta: None  # noqa: E731
    for wrong in (picture(1000, 1000), picture(1, 1), b"RIFF\0\0\0\0WEBPVP8L"):
        refused(changed_sog(unchanged, {"quats.webp": wrong}), ".sog", r"quats\.webp (has|cannot)")
    bomb = changed_sog(unchanged, {"quats.webp": bytes(2 * 10**7)})
    refused(bomb, ".sog", "inflates to 20000000 bytes")


def test_sog_values_that_overflow_are_dropped() -> None:
    def infinite(meta: dict) -> None:
        meta["means"]["maxs"] = [1e5, 1, 1]

    scene = read_scene(changed_sog(infinite), ".sog")
    assert scene.dropped > 0
    assert scene.non_finite == {"means": scene.dropped}


def changed_glb(change: Callable[[dict], object], whole: bytes = SMALL[".glb"]) -> bytes:
    length = struct.unpack_from("<I", whole, 12)[0]
    document = json.loads(whole[20 : 20 + length])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = whole[20 + length :]
    head = struct.pack("<IIIII", 0x46546C67, 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    return head + text + rest


def circle(document: dict) -> None:
    document["nodes"][0]["children"] = [0]


def deep(document: dict) -> None:
    document["nodes"] += [{"children": [len(document["nodes"]) + i + 1]} for i in range(2000)]
    document["scenes"][0]["nodes"] = [len(document["nodes"]) - 2000]


def crowded(document: dict) -> None:
    """A few bytes a node, and a whole scene in each."""
    document["nodes"] += [{"mesh": 0}] * 1100
    document["scenes"][0]["nodes"] = list(range(len(document["nodes"])))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d["nodes"][0].update(matrix=[10**400] * 16), "damaged"),
        (lambda d: d["nodes"][0].update(translation=[10**400, 0, 0]), "damaged"),
        (lambda d: d["accessors"][2].update(type="SCALAR"), "ROTATION' has 1 instead of 4"),
        (lambda d: d["accessors"][3].update(type="SCALAR"), "SCALE' has 1 instead of 3"),
        (lambda d: d["accessors"][0].update(count=10**12), "array ends after its data"),
        (lambda d: d["accessors"][0].update(count=-1), "no size"),
        (lambda d: d["accessors"][0].update(count=2.5), "no size"),
        (lambda d: d["accessors"][0].update(componentType=9), "damaged"),
        (lambda d: d["accessors"][0].update(type="MAT4"), "damaged"),
        (lambda d: d["accessors"][2].update(type="VEC3"), "damaged"),
        (lambda d: d["accessors"][2].update(bufferView=99), "damaged: list index out of range"),
        (lambda d: d["accessors"][3].update(bufferView=-1), "no size"),
        (lambda d: d["accessors"][3].update(count=29), "damaged"),
        (lambda d: d["bufferViews"][0].update(byteOffset=10**15), "ends after the file"),
        (lambda d: d["bufferViews"][0].update(byteStride=1), "ends after the file"),
        (lambda d: d["buffers"][0].update(uri="scene.bin"), "not in the file itself"),
        (lambda d: d.update(nodes=7), "damaged"),
        (lambda d: d.update(scenes=[{"nodes": [10**6]}]), "damaged"),
        (lambda d: d.update(meshes=[]), "damaged"),
        (lambda d: d["meshes"][0].update(primitives=[{"attributes": {}}]), "without Gaussians"),
        (
            lambda d: d["meshes"][0]["primitives"][0]["attributes"].pop(
                "KHR_gaussian_splatting:SH_DEGREE_0_COEF_0"
            ),
            "no degree-0",
        ),
        (circle, "no tree"),
        (deep, "no tree"),
    ],
)
def test_gltf_descriptions_that_lie(change: Callable[[dict], object], words: str) -> None:
    refused(changed_glb(change), ".glb", words)


def test_gltf_nodes_that_multiply_gaussians() -> None:
    with pytest.raises(InputError, match="more than 1024 parts"):
        read_scene(changed_glb(crowded), ".glb")
    many = encode_scene(scene_of(20_000), {}, ".glb").data
    with pytest.raises(InputError, match=r"claims \d+ Gaussians in"):
        read_scene(changed_glb(crowded, many), ".glb")


def test_gltf_nodes_out_of_range_are_dropped() -> None:
    def far(document: dict) -> None:
        document["nodes"][0].update(matrix=[1e300] * 16)

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = read_scene(changed_glb(far), ".glb")
    assert (len(scene.gaussians), scene.dropped) == (0, 30)


def test_json_that_is_nested_too_deeply() -> None:
    text = b"[" * 100_000
    size = len(text)
    head = struct.pack("<IIIII", 0x46546C67, 2, 20 + size, size, 0x4E4F534A)
    refused(head + text, ".glb", "no JSON")


def ply(*lines: str, body: bytes = b"") -> bytes:
    return "\n".join(["ply", *lines, "end_header", ""]).encode() + body


LITTLE = "format binary_little_endian 1.0"


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (ply(LITTLE, "element vertex 3"), "names no property"),
        (ply(LITTLE, "element a 9", "property int i", "element vertex 0", "property int x"), "cut"),
        (
            ply(LITTLE, "element a 1", *["property int i"] * 2, "element vertex 0"),
            "names no property",
        ),
        (ply(LITTLE, f"element vertex {'9' * 5000}"), "bad line"),
        (ply(LITTLE, f"element vertex {'9' * 40}"), "bad line"),
        (ply(LITTLE, "element vertex " + "x" * 100_000), "bad line"),
        (
            ply(
                "format ascii 1.0",
                "element vertex 20000",
                "property float x",
                body=b"9" * 10**6 + b"\n1" * 19999,
            ),
            "a row of 1000001 bytes is not 1 numbers",
        ),
    ],
)
def test_ply_headers_that_lie(data: bytes, words: str) -> None:
    refused(data, ".ply", words)


def test_compressed_plys_that_lie() -> None:
    whole = SMALL[".compressed.ply"]
    refused(whole.replace(b"element chunk 1\n", b"element chunk 0\n"), ".ply", "0 chunks for 30")
    refused(whole.replace(b"vertex 30\n", b"vertex 99999999\n"), ".ply", "cut off")
    refused(whole.replace(b"packed_scale", b"packed_scbbb"), ".ply", "another kind: no packed_sc")
    broken = bytearray(whole)
    place = whole.index(b"end_header\n") + len(b"end_header\n")
    broken[place : place + 4] = struct.pack("<f", np.nan)  # the chunk's least x
    scene = read_scene(bytes(broken), ".ply")
    assert (scene.dropped, scene.non_finite) == (30, {"means": 30})


def test_splats_that_lie() -> None:
    rows = np.frombuffer(SMALL[".splat"], ROW).copy()
    rows["means"][0, 1] = np.nan
    rows["scales"][1] = np.inf
    rows["scales"][2] *= -1
    rows["turn"][3] = 128  # a rotation of length 0
    scene = read_scene(rows.tobytes(), ".splat")
    assert (scene.dropped, scene.non_finite) == (2, {"means": 1, "scales": 1})
    assert (scene.gaussians.scales > 0).all()
    assert scene.gaussians.rotations[1].tolist() == [1, 0, 0, 0]
    refused(SMALL[".splat"][:-1], ".splat", "not a .splat, or cut off: 959 bytes")
