"""EXR frames, read back with OpenEXR: colours, alpha, depth, camera, and what they say of it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import OpenEXR
import pytest
from hypothesis import given
from hypothesis import strategies as st

from styl3r_cli import exr, main
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.stored import cameras_to_metadata
from styl3r_cli.errors import OutputError
from styl3r_cli.exr import ExrOptions
from styl3r_cli.formats import write_scene
from styl3r_cli.frames import to_picture
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.splatting import render


def turned_camera() -> Camera:
    """Not at the origin, not straight ahead, and not centred."""
    turn = np.linalg.qr(np.array([[1, 0.1, -0.2], [0, 1, 0.15], [0.2, -0.1, 1]]))[0]
    extrinsics = np.eye(4)
    extrinsics[:3, :3] = turn * np.sign(np.diag(turn))
    extrinsics[:3, 3] = [0.2, -0.1, 0.4]
    return Camera(extrinsics, 70.0, 66.0, 30.0, 27.0, 64, 48)


@pytest.fixture(scope="module")
def gaussians() -> Gaussians:
    rng = np.random.default_rng(3)
    return Gaussians(
        means=rng.uniform([-0.8, -0.5, 2], [0.8, 0.5, 3], (200, 3)),
        scales=rng.uniform(0.02, 0.06, (200, 3)),
        rotations=np.tile([1.0, 0, 0, 0], (200, 1)),
        opacities=rng.uniform(0.3, 1, 200),
        colours=rng.uniform(0, 1.1, (200, 3)),
    )


def read(path: Path) -> tuple[dict[str, np.ndarray], dict[str, object]]:
    file = OpenEXR.File(str(path), separate_channels=True)
    return {name: channel.pixels for name, channel in file.channels().items()}, file.header()


def srgb(linear: np.ndarray) -> np.ndarray:
    """The transfer function as IEC 61966-2-1 states it, in float64."""
    linear = linear.astype(np.float64)
    power = 1.055 * np.maximum(linear, 1e-12) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, power)


def test_layout(gaussians: Gaussians, tmp_path: Path) -> None:
    camera = turned_camera()
    frame = render(gaussians, camera, None)
    exr.write_exr(tmp_path / "a.exr", frame, camera, ExrOptions(provenance={"software": "test"}))
    channels, header = read(tmp_path / "a.exr")
    assert {name: values.dtype for name, values in channels.items()} == {
        **dict.fromkeys("RGBA", np.float16),
        "Z": np.float32,
    }
    assert all(values.shape == (48, 64) for values in channels.values())
    assert header["compression"] == OpenEXR.ZIP_COMPRESSION
    assert header["type"] == OpenEXR.scanlineimage
    assert header["software"] == "test"
    assert header["colorInteropID"] == "lin_rec709_scene"


def test_frames_agree_with_the_pictures(gaussians: Gaussians, tmp_path: Path) -> None:
    """An EXR taken back to sRGB, over black or white, is the PNG of the same view."""
    scene = tmp_path / "scene.ply"
    camera = turned_camera()
    write_scene(scene, gaussians, {"model": "mini", **cameras_to_metadata([camera] * 2)})
    pattern = tmp_path / "frames" / "%04d.exr"
    arguments = ["render", scene, "--path", "interpolate", "--frames", "2", "-o", pattern]
    assert main.run([*map(str, arguments), "--size", "64x48", "--threads", "1"]) == 0
    assert sorted(p.name for p in pattern.parent.iterdir()) == ["0000.exr", "0001.exr"]
    channels, header = read(pattern.parent / "0001.exr")
    assert header["styl3r.model"] == "mini"
    alpha = channels["A"].astype(np.float64)
    seen = alpha > 0.01  # below, a half float's steps divided by alpha are large
    assert 0.2 < seen.mean() < 1
    for background in (0.0, 1.0):
        picture = to_picture(render(gaussians, camera, (background,) * 3).colour)
        for index, name in enumerate("RGB"):
            straight = srgb(channels[name][seen] / alpha[seen])
            expected = straight * alpha[seen] + background * (1 - alpha[seen])
            assert np.abs(expected.clip(0, 1) * 255 - picture[..., index][seen]).max() < 1.0


def test_depth_is_far_where_nothing_is(gaussians: Gaussians, tmp_path: Path) -> None:
    camera = turned_camera()
    frame = render(gaussians, camera, None)
    exr.write_exr(tmp_path / "a.exr", frame, camera, ExrOptions())
    channels, _ = read(tmp_path / "a.exr")
    empty = frame.alpha == 0
    assert empty.any()
    assert (channels["Z"][empty] == np.float32(exr.EMPTY_DEPTH)).all()
    np.testing.assert_array_equal(channels["Z"][~empty], frame.depth[~empty])
    assert channels["Z"][~empty].max() < 5


def test_matrices_find_a_gaussian(tmp_path: Path) -> None:
    """Points are row vectors, the camera's y goes up, NDC runs from corner to corner."""
    point = np.array([0.3, -0.2, 2.5])
    dot = Gaussians(
        means=point[None],
        scales=np.full((1, 3), 0.02),
        rotations=np.array([[1.0, 0, 0, 0]]),
        opacities=np.array([0.9]),
        colours=np.ones((1, 3)),
    )
    camera = turned_camera()
    exr.write_exr(tmp_path / "a.exr", render(dot, camera, None), camera, ExrOptions())
    channels, header = read(tmp_path / "a.exr")
    alpha = channels["A"].astype(np.float64)
    rows, columns = np.mgrid[0:48, 0:64] + 0.5
    centre = np.array([(alpha * columns).sum(), (alpha * rows).sum()]) / alpha.sum()
    homogeneous = np.append(point, 1) @ header["worldToNDC"]
    np.testing.assert_allclose(homogeneous[:2] / homogeneous[3] * [64, 48], centre, atol=0.05)
    in_camera = np.append(point, 1) @ header["worldToCamera"]
    right, up, depth = in_camera[:3]
    assert depth == pytest.approx(channels["Z"][alpha > 0.5].mean(), rel=1e-3)
    assert (70 * right / depth + 30, -66 * up / depth + 27) == pytest.approx(tuple(centre), abs=0.1)


@given(st.floats(-1, 50), st.floats(0, 1))
def test_colours_become_linear(value: float, alpha: float) -> None:
    colour = np.full((1, 1, 3), value * alpha, np.float32)
    linear = exr.linear_premultiplied(colour, np.full((1, 1), alpha, np.float32))
    if np.float32(alpha) == 0 or value <= 0:
        assert (linear == 0).all()
    elif alpha > 1e-30:  # a colour times less is not a normal float32
        back = srgb(linear / np.float32(alpha))
        np.testing.assert_allclose(back, value, rtol=1e-4, atol=1e-6)


def test_colours_too_bright_for_half_floats_stay_finite(
    gaussians: Gaussians, tmp_path: Path
) -> None:
    camera = Camera(np.eye(4), 4, 4, 2, 2, 4, 4)
    colour = np.full((4, 4, 3), 1e30, np.float32)
    opaque = np.ones((4, 4), np.float32)
    frame = replace(render(gaussians, camera, None), colour=colour, alpha=opaque)
    exr.write_exr(tmp_path / "a.exr", frame, camera, ExrOptions())
    assert (read(tmp_path / "a.exr")[0]["R"] == 65504).all()


@pytest.mark.parametrize("compression", exr.COMPRESSIONS)
def test_bright_dots_stay_finite_in_every_compression(
    gaussians: Gaussians, tmp_path: Path, compression: str
) -> None:
    """DWAA and DWAB overshoot beside an edge, which from half floats' end is infinity."""
    camera = Camera(np.eye(4), 16, 16, 8, 8, 16, 16)
    for seed in range(10):
        dots = np.random.default_rng(seed).random((16, 16, 1)) < 0.1 * seed
        colour = np.where(dots, np.float32(1e30), np.float32(0.5)).repeat(3, axis=2)
        opaque = np.ones((16, 16), np.float32)
        frame = replace(render(gaussians, camera, None), colour=colour, alpha=opaque)
        exr.write_exr(tmp_path / "a.exr", frame, camera, ExrOptions(compression))
        back = read(tmp_path / "a.exr")[0]
        assert all(np.isfinite(back[name]).all() for name in "RGBA")
        assert (back["R"][dots[..., 0]] > 40_000).all()


def test_same_frame_same_bytes(gaussians: Gaussians, tmp_path: Path) -> None:
    camera = turned_camera()
    for name in ("a.exr", "b.exr"):
        exr.write_exr(tmp_path / name, render(gaussians, camera, None), camera, ExrOptions())
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


def test_failure_leaves_nothing(gaussians: Gaussians, tmp_path: Path) -> None:
    camera = turned_camera()
    frame = render(gaussians, camera, None)
    with pytest.raises(OutputError, match="does not exist"):
        exr.write_exr(tmp_path / "no" / "a.exr", frame, camera, ExrOptions())
    assert list(tmp_path.iterdir()) == []


def test_full_disk_is_one_line(gaussians: Gaussians) -> None:
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("no /dev/full here")
    camera = turned_camera()
    with pytest.raises(OutputError, match="cannot write /dev/full"):
        exr.write_exr(full, render(gaussians, camera, None), camera, ExrOptions())


@pytest.mark.skipif(sys.platform == "win32", reason="no limit on files' sizes there")
@pytest.mark.parametrize("compression", exr.COMPRESSIONS)
def test_a_disk_that_is_full_at_the_last_byte(
    gaussians: Gaussians, tmp_path: Path, compression: str
) -> None:
    """The library's own files swallow what fails when they are closed."""
    import resource

    camera = turned_camera()
    frame, options = render(gaussians, camera, None), ExrOptions(compression)
    exr.write_exr(tmp_path / "whole.exr", frame, camera, options)
    size = (tmp_path / "whole.exr").stat().st_size
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        for missing in (1, 100, 1000):
            resource.setrlimit(resource.RLIMIT_FSIZE, (size - missing, hard))
            with pytest.raises(OutputError, match=r"cut\.exr: File too large"):
                exr.write_exr(tmp_path / "cut.exr", frame, camera, options)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [path.name for path in tmp_path.iterdir()] == ["whole.exr"]


@pytest.mark.parametrize("compression", exr.COMPRESSIONS)
def test_every_compression_keeps_what_it_says(
    gaussians: Gaussians, tmp_path: Path, compression: str
) -> None:
    camera = turned_camera()
    frame = render(gaussians, camera, None)
    exr.write_exr(tmp_path / "a.exr", frame, camera, ExrOptions())
    exr.write_exr(tmp_path / "b.exr", frame, camera, ExrOptions(compression))
    expected, _ = read(tmp_path / "a.exr")
    channels, header = read(tmp_path / "b.exr")
    assert (
        str(header["compression"])
        .lower()
        .endswith(f"{compression.replace('none', 'no')}_compression")
    )
    for name in "AZ":
        np.testing.assert_array_equal(channels[name], expected[name])
    for name in "RGB":
        error = np.abs(channels[name].astype(float) - expected[name]).max()
        assert error <= (0.05 if compression.startswith("dwa") else 0)


def test_parts_on_request(gaussians: Gaussians, tmp_path: Path) -> None:
    camera = turned_camera()
    frame = render(gaussians, camera, None)
    exr.write_exr(tmp_path / "a.exr", frame, camera, ExrOptions())
    exr.write_exr(tmp_path / "b.exr", frame, camera, ExrOptions(multi_part=True, fps=29.97))
    single, _ = read(tmp_path / "a.exr")
    file = OpenEXR.File(str(tmp_path / "b.exr"), separate_channels=True)
    assert [(part.name(), set(part.channels)) for part in file.parts] == [
        ("rgba", set("RGBA")),
        ("depth", {"Z"}),
    ]
    for part in file.parts:
        assert part.header["framesPerSecond"] == Fraction(30000, 1001)
        assert part.header["worldToNDC"].shape == (4, 4)
        for name, channel in part.channels.items():
            np.testing.assert_array_equal(channel.pixels, single[name])


def test_rate_and_provenance_are_standard_attributes(gaussians: Gaussians, tmp_path: Path) -> None:
    camera = turned_camera()
    options = ExrOptions(fps=24, provenance={"software": "styl3r 9", "styl3r.model": "mini"})
    exr.write_exr(tmp_path / "a.exr", render(gaussians, camera, None), camera, options)
    _, header = read(tmp_path / "a.exr")
    assert header["framesPerSecond"] == 24
    assert header["comments"] == "software: styl3r 9; styl3r.model: mini"
    assert header["styl3r.model"] == "mini"


@pytest.mark.parametrize("multi_part", [False, True])
def test_ffmpeg_reads_the_same_colours(
    gaussians: Gaussians, tmp_path: Path, multi_part: bool
) -> None:
    """A second reader, whose decoder is its own."""
    camera = turned_camera()
    options = ExrOptions(multi_part=multi_part)
    exr.write_exr(tmp_path / "a.exr", render(gaussians, camera, None), camera, options)
    with av.open(str(tmp_path / "a.exr")) as container:
        frame = next(container.decode(video=0))
    assert frame.format.name == "gbrapf16le"
    channels, _ = read(tmp_path / "a.exr")
    for name, plane in zip("GBRA", frame.planes, strict=True):
        rows = np.frombuffer(plane, np.float16).reshape(plane.height, -1)
        np.testing.assert_array_equal(rows[:, : plane.width], channels[name])


def test_opencv_reads_the_same_colours(gaussians: Gaussians, tmp_path: Path) -> None:
    """In a process of its own: OpenCV looks at its environment once."""
    found = re.search(r"OpenEXR:\s+(\S+)", cv2.getBuildInformation())
    if found is None or found[1] == "NO":
        pytest.skip("this OpenCV was built without OpenEXR")
    camera = turned_camera()
    exr.write_exr(tmp_path / "a.exr", render(gaussians, camera, None), camera, ExrOptions())
    code = (
        "import cv2, numpy, sys; picture = cv2.imread(sys.argv[1], cv2.IMREAD_UNCHANGED);"
        "numpy.save(sys.argv[2], picture)"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "a.exr"), str(tmp_path / "a.npy")]
    environment = os.environ | {"OPENCV_IO_ENABLE_OPENEXR": "1"}
    subprocess.run(command, env=environment, check=True)
    picture = np.load(tmp_path / "a.npy")
    channels, _ = read(tmp_path / "a.exr")
    for index, name in enumerate("BGRA"):
        np.testing.assert_array_equal(picture[..., index], channels[name].astype(np.float32))
