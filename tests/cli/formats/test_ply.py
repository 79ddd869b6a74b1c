"""The PLY that viewers open: against an independent reader and foreign files."""

from __future__ import annotations

import io
import tracemalloc
from pathlib import Path

import numpy as np
import plyfile
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from styl3r_cli.errors import InputError, UsageError
from styl3r_cli.formats import encode_scene, ply_container, read_scene, write_scene
from styl3r_cli.formats.ply import decode
from styl3r_cli.formats.ply_container import MOST_ROWS, read_element
from styl3r_cli.formats.values import LOGIT_LIMIT, SMALLEST_SCALE
from styl3r_cli.gaussians import Gaussians

LAYOUT = (
    "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
)


def independent(data: bytes) -> plyfile.PlyData:
    return plyfile.PlyData.read(io.BytesIO(data))


def same(one: Gaussians, other: Gaussians, tolerance: float = 1e-6) -> None:
    np.testing.assert_array_equal(one.means, other.means)
    np.testing.assert_allclose(one.scales, other.scales, rtol=3e-6)  # ln of 1e-4 has 2e-7 left
    np.testing.assert_allclose(one.rotations, other.rotations, atol=tolerance)
    np.testing.assert_allclose(one.opacities, other.opacities, atol=tolerance)
    np.testing.assert_allclose(one.colours, other.colours, atol=tolerance)


def test_plyfile_reads_what_the_formulas_say(scene: Gaussians) -> None:
    ply = independent(encode_scene(scene).data)
    assert [element.name for element in ply.elements] == ["vertex"]
    assert ply.byte_order == "<"
    vertex = ply["vertex"]
    assert [p.name for p in vertex.properties] == LAYOUT.split()
    assert {p.val_dtype for p in vertex.properties} == {"f4"}
    assert len(vertex.data) == len(scene)
    stack = lambda *names: np.stack([vertex[n] for n in names], 1).astype(np.float64)  # noqa: E731
    np.testing.assert_array_equal(stack("x", "y", "z"), scene.means)
    np.testing.assert_array_equal(stack("nx", "ny", "nz"), 0)
    np.testing.assert_allclose(1 / (1 + np.exp(-vertex["opacity"])), scene.opacities, atol=1e-6)
    np.testing.assert_allclose(np.exp(stack("scale_0", "scale_1", "scale_2")), scene.scales, 3e-6)
    colours = 0.5 + stack("f_dc_0", "f_dc_1", "f_dc_2") / np.sqrt(4 * np.pi)
    np.testing.assert_allclose(colours, scene.colours, atol=1e-6)
    np.testing.assert_allclose(
        stack("rot_0", "rot_1", "rot_2", "rot_3"), scene.rotations, atol=1e-6
    )


def test_opacity_ends_are_finite_and_come_back() -> None:
    count = 4
    opacities = np.array([0, 1, 1 - 2**-24, 0.5], np.float32)
    identity = np.tile([1, 0, 0, 0], (count, 1))
    scene = Gaussians(np.zeros((4, 3)), np.ones((4, 3)), identity, opacities, np.zeros((4, 3)))
    data = encode_scene(scene).data
    stored = independent(data)["vertex"]["opacity"]
    assert stored[:2].tolist() == [-LOGIT_LIMIT, LOGIT_LIMIT]
    back = read_scene(data).gaussians.opacities
    assert back[1] == 1
    assert back[2] == opacities[2]
    assert back[3] == 0.5
    assert 0 <= back[0] < 1e-7


def test_flat_scales_and_zero_rotations_are_made_storable() -> None:
    scales = np.array([[0, 1e-20, 1], [1, 1, 1]])
    scene = Gaussians(np.zeros((2, 3)), scales, np.zeros((2, 4)), np.ones(2), np.zeros((2, 3)))
    encoded = encode_scene(scene)
    back = read_scene(encoded.data).gaussians
    np.testing.assert_allclose(back.scales[0], [SMALLEST_SCALE, SMALLEST_SCALE, 1], rtol=1e-5)
    np.testing.assert_array_equal(back.rotations, [[1, 0, 0, 0]] * 2)
    assert encoded.notes == ["1 Gaussians were flatter than 1e-10 and made so thick"]


def test_gaussians_that_are_not_finite_are_dropped_and_counted(scene: Gaussians) -> None:
    arrays = {name: getattr(scene, name).copy() for name in Gaussians.__dataclass_fields__}
    for row, (name, bad) in enumerate(
        zip(arrays, [np.nan, np.inf, np.nan, -np.inf, np.nan], strict=True)
    ):
        arrays[name][row] = bad
    encoded = encode_scene(Gaussians(**arrays))
    assert (encoded.dropped, encoded.count) == (5, 495)
    assert encoded.notes == ["5 of 500 Gaussians were not finite and left out"]
    same(read_scene(encoded.data).gaussians, scene.select(np.arange(5, 500)))


def test_metadata_is_in_comments_and_survives(scene: Gaussians) -> None:
    metadata = {
        "styl3r": "0.1.0",
        "styles": 'Die Brücke, 北斎 = 0.5: \\ "x"\r\nend_header\n',
        "empty": "",
        "spaces": "  both ends  ",
    }
    data = encode_scene(scene, metadata).data
    assert read_scene(data).metadata == metadata
    assert len(independent(data).comments) == len(metadata)
    with pytest.raises(ValueError, match="metadata key"):
        encode_scene(scene, {"two words: x": ""})


def test_the_same_scene_gives_the_same_bytes(scene: Gaussians, tmp_path: Path) -> None:
    write_scene(tmp_path / "a.PLY", scene, {"a": "b"})
    assert (tmp_path / "a.PLY").read_bytes() == encode_scene(scene, {"a": "b"}).data


@pytest.mark.parametrize("text", [True, False])
@pytest.mark.parametrize("order", ["<", ">"])
def test_any_encoding_property_order_and_company(scene: Gaussians, text: bool, order: str) -> None:
    """What other programs write: shuffled, in double, with more properties and more elements."""
    vertex = independent(encode_scene(scene).data)["vertex"].data
    names = [name for name in reversed(LAYOUT.split()) if not name.startswith("n")]
    rows = np.zeros(len(scene), [(n, "f8") for n in names] + [("f_rest_0", "f4"), ("label", "u1")])
    for name in names:
        rows[name] = vertex[name]
    for index in range(4):
        rows[f"rot_{index}"] *= 7  # any length
    rows["f_rest_0"] = 0.25
    describe = plyfile.PlyElement.describe
    camera = describe(np.array([(1.5, 2)], [("f", "f4"), ("i", "i2")]), "camera")
    buffer = io.BytesIO()
    plyfile.PlyData(
        [camera, describe(rows, "vertex"), camera and describe(np.zeros(1, [("a", "u1")]), "end")],
        text=text,
        byte_order=order,
        comments=["made elsewhere"],
    ).write(buffer)
    back = read_scene(buffer.getvalue())
    same(back.gaussians, scene)
    assert back.notes == ["view-dependent colours (f_rest) are ignored"]


def test_mip_splattings_filter_is_part_of_the_gaussians(scene: Gaussians) -> None:
    """Its files keep the 3D smoothing filter (Yu et al. 2024) apart from scales and opacities."""
    vertex = independent(encode_scene(scene).data)["vertex"].data
    size = np.linspace(0, 0.1, len(scene)).astype("f4")
    rows = np.zeros(len(scene), [*vertex.dtype.descr, ("filter_3D", "f4")])
    for name in vertex.dtype.names:
        rows[name] = vertex[name]
    rows["filter_3D"] = size
    buffer = io.BytesIO()
    plyfile.PlyData([plyfile.PlyElement.describe(rows, "vertex")]).write(buffer)
    back = read_scene(buffer.getvalue()).gaussians
    squares = scene.scales.astype(float) ** 2
    wider = squares + size[:, None].astype(float) ** 2
    np.testing.assert_allclose(back.scales, np.sqrt(wider), rtol=1e-5)
    # The same mass in a larger volume: the amplitude of a convolved Gaussian.
    fainter = scene.opacities * np.sqrt(squares.prod(axis=1) / wider.prod(axis=1))
    np.testing.assert_allclose(back.opacities, fainter, rtol=1e-4, atol=1e-7)


def test_means_that_single_precision_moves_far_are_noted(scene: Gaussians) -> None:
    """As of a map in metres; at the origin the same scene is read without a word."""
    written = independent(encode_scene(scene).data)["vertex"].data
    rows = written.astype([(name, "f8") for name in written.dtype.names])
    rows["x"] += 0.3  # no number of single precision

    def notes(distance: float) -> list[str]:
        rows["y"] = written["y"].astype(np.float64) + distance
        stream = io.BytesIO()
        plyfile.PlyData([plyfile.PlyElement.describe(rows, "vertex")]).write(stream)
        return read_scene(stream.getvalue()).notes

    assert notes(0) == []
    (note,) = notes(5e6)
    assert note.startswith("means are rounded to single precision, by up to 0.2")


def test_windows_line_ends(scene: Gaussians) -> None:
    data = encode_scene(scene, {"key": "value"}).data
    end = data.index(b"end_header\n") + len(b"end_header\n")
    crlf = data[:end].replace(b"\n", b"\r\n") + data[end:]
    back = read_scene(crlf)
    same(back.gaussians, scene)
    assert back.metadata == {"key": "value"}


def test_infinities_that_other_writers_leave(scene: Gaussians) -> None:
    data = encode_scene(scene.select(np.arange(3))).data
    rows = np.frombuffer(data[-3 * 68 :], "<f4").reshape(3, 17).copy()
    rows[0, 9] = np.inf  # logit of 1
    rows[1, 10] = -np.inf  # ln of 0
    rows[2, 0] = np.nan
    back = read_scene(data[: -3 * 68] + rows.tobytes())
    assert back.dropped == 1
    assert back.gaussians.opacities[0] == 1
    assert back.gaussians.scales[1, 0] == 0


def test_empty_scene() -> None:
    empty = Gaussians(*(np.zeros(shape) for shape in [(0, 3), (0, 3), (0, 4), (0,), (0, 3)]))
    data = encode_scene(empty).data
    assert len(read_scene(data).gaussians) == 0
    assert len(independent(data)["vertex"].data) == 0


def header(*lines: str) -> bytes:
    return "\n".join(["ply", *lines, "end_header", ""]).encode()


ONE_COLUMN = ("element vertex 1", "property float x")


def ascii_rows(count: int, rows: bytes) -> bytes:
    """A text PLY of one column that claims so many rows."""
    return header("format ascii 1.0", f"element vertex {count}", ONE_COLUMN[1]) + rows


LITTLE = "format binary_little_endian 1.0"
# Flat Gaussians (Huang et al. 2024) have two scales.
FLAT = [name for name in LAYOUT.split() if name != "scale_2"]


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "the file is empty"),
        (b"\x89PNG\r\n", "not a PLY file"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\n", "no end"),
        (header(LITTLE), "no 'vertex' element"),
        (header(LITTLE, "element face 0", "property list uchar int i"), "no 'vertex' element"),
        (header("element vertex 0", "property float x"), "does not say its format"),
        (header("format ascii 2.0", *ONE_COLUMN), r"PLY of version 2\.0; only 1\.0 can be read"),
        (header(LITTLE, "format ascii 1.0", *ONE_COLUMN), "bad line.*'format ascii 1.0'"),
        (header(LITTLE, *ONE_COLUMN * 2), "the PLY has several 'vertex' elements"),
        (
            header(LITTLE, "element vertex many"),
            "bad line in the PLY header: 'element vertex many'",
        ),
        (header(LITTLE, "element vertex -1"), "bad line"),
        (header("format binary_middle_endian 1.0"), "bad line"),
        (header(LITTLE, "element vertex 0", "property quad x"), "bad line.*quad"),
        (header(LITTLE, "property float x"), "bad line"),
        (header(LITTLE, "element vertex 0", *["property float x"] * 2), "'vertex' twice"),
        (
            header(LITTLE, "element vertex 0", *[f"property float {n}" for n in "xyz"]),
            "a point cloud or mesh, not 3D Gaussians: it has no f_dc_0",
        ),
        (
            header(LITTLE, "element vertex 0", *[f"property float {n}" for n in FLAT]),
            "(?<!, )not 3D Gaussians: it has no scale_2",
        ),
        (
            header(LITTLE, "element vertex 0", "property uint packed_position"),
            "the PLY has no 'chunk' element",
        ),
        (
            header(LITTLE, "element vertex 9999999999", "property float x"),
            "cut off: 0 of 9999999999",
        ),
        (ascii_rows(1, b"abc"), "a row is not the header's 1 numbers: could not convert .*'abc'"),
        (ascii_rows(1, b"1 2"), "a row is not the header's 1 numbers: it has 2"),
        (ascii_rows(3, b"1\n2\n3 4\n"), "a row is not the header's 1 numbers: .* at row 3"),
        (ascii_rows(2, b"1\n"), "cut off: 1 of 2 Gaussians are there"),
        (ascii_rows(2, b"\n \n"), "cut off: 0 of 2 Gaussians are there"),
        (ascii_rows(MOST_ROWS, b"1\n"), "cut off: 1 of 1152921504606846976 Gaussians"),
        (ascii_rows(1, b"\n" * 5000), "more empty lines than rows"),
        (ascii_rows(1, b"1" * 5000), "a row of 5000 bytes is not 1 numbers"),
        (
            header("format ascii 1.0", *["element a 1152921504606846976"] * 20, *ONE_COLUMN),
            "cut off: 0 of 1 Gaussians",
        ),
    ],
)
def test_broken_files_say_what_is_wrong(tmp_path: Path, data: bytes, words: str) -> None:
    path = tmp_path / "s.ply"
    path.write_bytes(data)
    with pytest.raises(InputError, match=rf"s\.ply: .*{words}") as caught:
        read_scene(path)
    assert "\n" not in str(caught.value)


def as_text(scene: Gaussians, end: str = "\n") -> bytes:
    """The scene as a text PLY, in digits that give the same float64 back."""
    element = independent(encode_scene(scene).data)["vertex"]
    lines = ["format ascii 1.0", f"element vertex {len(scene)}"]
    lines += [f"property float {name}" for name in element.data.dtype.names]
    rows = [" ".join(repr(float(value)) for value in row) for row in element.data]
    return header(*lines) + (end.join(rows) + end).encode()


@pytest.mark.parametrize("end", ["\n", "\r\n", "\n\n", " \t\n"])
def test_text_is_read_to_the_last_bit(scene: Gaussians, end: str) -> None:
    back, binary = (
        read_scene(data).gaussians for data in (as_text(scene, end), encode_scene(scene).data)
    )
    for name in ("means", "scales", "rotations", "opacities", "colours"):
        np.testing.assert_array_equal(getattr(back, name), getattr(binary, name))


def test_text_takes_no_more_memory_than_the_file() -> None:
    rows = 20_000
    data = ascii_rows(rows, b"0.12345678\n" * rows)
    tracemalloc.start()
    try:
        table = read_element(data, "a.ply")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(table.rows) == rows
    assert peak < 3 * len(data)  # it was 10 times, and more with more columns


def test_too_much_text_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ply_container, "LARGEST_TEXT", 2_000_000)
    with pytest.raises(InputError, match=r"2 MB of text is more than is read; save it as a binary"):
        read_element(ascii_rows(1, b"1\n" * 1_100_000), "a.ply")


@pytest.mark.parametrize("text", [False, True])
def test_what_follows_the_last_row_is_told(scene: Gaussians, text: bool) -> None:
    data = as_text(scene) if text else encode_scene(scene).data
    more = data + data[-len(data) // 4 :]
    for whole, notes in ((data, 0), (data + b"\n" * text, 0), (more, 1)):
        read = decode(whole, "x.ply")
        assert len(read.gaussians) == len(scene)
        assert sum("follows the last Gaussian" in note for note in read.notes) == notes


def test_cut_off_file(scene: Gaussians) -> None:
    with pytest.raises(InputError, match="cut off: 499 of 500 Gaussians are there"):
        read_scene(encode_scene(scene).data[:-1])


def test_unknown_formats_and_missing_files(tmp_path: Path, scene: Gaussians) -> None:
    with pytest.raises(UsageError, match=r"unknown scene format '\.obj'; use one of \.ply"):
        write_scene(tmp_path / "a.obj", scene)
    with pytest.raises(InputError, match=r"gone\.ply: cannot be read"):
        read_scene(tmp_path / "gone.ply")
    with pytest.raises(InputError, match="not a scene in a known format"):
        read_scene(b"GIF89a")


finite = st.floats(-1e6, 1e6, width=32)


@st.composite
def scenes(draw: st.DrawFn) -> Gaussians:
    count = draw(st.integers(0, 6))
    array = lambda *shape, of: draw(hnp.arrays(np.float32, (count, *shape), elements=of))  # noqa: E731
    return Gaussians(
        means=array(3, of=finite),
        scales=array(3, of=st.floats(0, 1e6, width=32)),
        rotations=array(4, of=finite),
        opacities=array(of=st.floats(0, 1, width=32)),
        colours=array(3, of=st.floats(-2, 3, width=32)),
    )


@given(scenes())
@settings(max_examples=80, deadline=None)
def test_whatever_is_finite_comes_back(scene: Gaussians) -> None:
    data = encode_scene(scene).data
    assert all(np.isfinite(independent(data)["vertex"][name]).all() for name in LAYOUT.split())
    back = read_scene(data)
    assert back.dropped == 0
    np.testing.assert_array_equal(back.gaussians.means, scene.means)
    np.testing.assert_allclose(back.gaussians.opacities, scene.opacities, atol=3e-7)
    np.testing.assert_allclose(back.gaussians.colours, scene.colours, atol=1e-6)
    floored = np.maximum(scene.scales, SMALLEST_SCALE)
    np.testing.assert_allclose(back.gaussians.scales, floored, rtol=5e-6)
    np.testing.assert_allclose(np.linalg.norm(back.gaussians.rotations, axis=1), 1, rtol=1e-6)
    turning = np.linalg.norm(scene.rotations, axis=1) > 0
    wanted = scene.rotations[turning].astype(np.float64)
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    np.testing.assert_allclose(back.gaussians.rotations[turning], wanted, atol=1e-6)
