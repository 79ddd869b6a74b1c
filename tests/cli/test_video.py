"""Videos, decoded again by PyAV and OpenCV."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from styl3r_cli.errors import OutputError, UsageError
from styl3r_cli.movies import write_movie
from styl3r_cli.video import frame_rate, write_video


def make_frames(count: int, width: int, height: int) -> Iterator[np.ndarray]:
    """Smooth pictures that change from frame to frame."""
    y, x = np.mgrid[0:height, 0:width]
    for index in range(count):
        red = 255 * x / max(width - 1, 1)
        green = 255 * y / max(height - 1, 1)
        blue = np.full_like(red, 255 * index / max(count - 1, 1))
        yield np.stack([red, green, blue], -1).astype(np.uint8)


def boxes(data: bytes) -> list[str]:
    """Names of an MP4's outer boxes, in order."""
    names, start = [], 0
    while start < len(data):
        size, name = int.from_bytes(data[start : start + 4], "big"), data[start + 4 : start + 8]
        names.append(name.decode())
        start += size
    return names


@pytest.mark.parametrize(("width", "height"), [(64, 48), (63, 47), (1, 1), (33, 18)])
def test_a_video_decodes_to_its_frames(tmp_path: Path, width, height):
    path = tmp_path / "a.mp4"
    assert write_video(path, make_frames(7, width, height), 24) == 7
    even = (width + width % 2, height + height % 2)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt) == ("h264", "yuv420p")
        assert (stream.width, stream.height) == even
        assert stream.average_rate == 24
        decoded = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    assert len(decoded) == 7
    for picture, original in zip(decoded, make_frames(7, width, height), strict=True):
        error = np.abs(picture[:height, :width].astype(int) - original)
        assert error.mean() < 6


def test_opencv_reads_it_too(tmp_path: Path):
    path = tmp_path / "a.mp4"
    write_video(path, make_frames(5, 80, 60), 25)
    capture = cv2.VideoCapture(str(path))
    assert capture.get(cv2.CAP_PROP_FRAME_COUNT) == 5
    assert capture.get(cv2.CAP_PROP_FPS) == pytest.approx(25)
    good, picture = capture.read()
    assert good
    assert picture.shape == (60, 80, 3)
    expected = next(make_frames(5, 80, 60))[..., ::-1]
    assert np.abs(picture.astype(int) - expected).mean() < 4


def test_a_browser_can_start_before_it_has_everything(tmp_path: Path):
    path = tmp_path / "a.mp4"
    write_video(path, make_frames(5, 80, 60), 25)
    order = boxes(path.read_bytes())
    assert order.index("moov") < order.index("mdat")


@pytest.mark.parametrize("colour", [(255, 0, 0), (0, 255, 0), (0, 0, 255), (200, 120, 40)])
def test_colours_are_bt709_and_say_so(tmp_path: Path, colour):
    path = tmp_path / "a.mp4"
    write_video(path, [np.full((48, 64, 3), colour, np.uint8)] * 3, 24)
    with av.open(str(path)) as container:
        context = container.streams.video[0].codec_context
        frame = next(container.decode(video=0))
        tags = (context.colorspace, context.color_primaries, context.color_trc, context.color_range)
        assert tuple(map(int, tags)) == (1, 1, 1, 1)
        planes = frame.to_ndarray().astype(float)
    # ITU-R BT.709: luma from gamma-coded red, green and blue, in 16 to 235.
    red, green, blue = np.array(colour) / 255
    luma = 0.2126 * red + 0.7152 * green + 0.0722 * blue
    assert planes[:48].mean() == pytest.approx(16 + 219 * luma, abs=2)
    assert planes[48:60].mean() == pytest.approx(128 + 224 * (blue - luma) / 1.8556, abs=2)
    assert planes[60:].mean() == pytest.approx(128 + 224 * (red - luma) / 1.5748, abs=2)


def test_an_odd_edge_is_repeated(tmp_path: Path):
    path = tmp_path / "a.mp4"
    picture = np.zeros((31, 31, 3), np.uint8)
    picture[:, 16:] = 255
    write_video(path, [picture] * 2, 10)
    with av.open(str(path)) as container:
        decoded = next(container.decode(video=0)).to_ndarray(format="rgb24")
    assert decoded.shape == (32, 32, 3)
    assert decoded[:, 31].min() > 240
    assert decoded[31, :12].max() < 15


def test_a_fractional_rate_is_exact(tmp_path: Path):
    path = tmp_path / "a.mp4"
    write_video(path, make_frames(4, 16, 16), 30000 / 1001)
    with av.open(str(path)) as container:
        rate = container.streams.video[0].average_rate
        assert (rate.numerator, rate.denominator) == (30000, 1001)


def test_rounded_broadcast_rates_are_meant():
    assert [frame_rate(fps) for fps in (23.976, 23.98, 29.97, 59.94)] == [
        Fraction(24000, 1001),
        Fraction(24000, 1001),
        Fraction(30000, 1001),
        Fraction(60000, 1001),
    ]
    assert [frame_rate(fps) for fps in (24, 12.5, 30.0)] == [24, Fraction(25, 2), 30]


def test_one_frame_is_a_video(tmp_path: Path):
    path = tmp_path / "a.mp4"
    assert write_video(path, make_frames(1, 16, 16), 30) == 1
    with av.open(str(path)) as container:
        assert len(list(container.decode(video=0))) == 1


PANNING = """
import sys
from pathlib import Path
import numpy as np
from styl3r_cli.video import write_video
wall = np.random.default_rng(0).integers(0, 256, (10, 30, 3), np.uint8).repeat(8, 0).repeat(8, 1)
write_video(Path(sys.argv[1]), [wall[:, 3 * i : 144 + 3 * i] for i in range(8)], 24, sys.argv[2])
"""


@pytest.mark.parametrize("kind", ["mp4", "webm", "webp"])
def test_same_frames_same_bytes(tmp_path: Path, kind: str):
    """Whatever memory held before (glibc fills it with the complement of MALLOC_PERTURB_)."""
    written = set()
    for filling in ("0", "1", "85", "170"):
        path = tmp_path / f"{filling}.{kind}"
        environment = os.environ | {"MALLOC_PERTURB_": filling}
        subprocess.run([sys.executable, "-c", PANNING, path, kind], env=environment, check=True)
        written.add(path.read_bytes())
    assert len(written) == 1


def test_a_failure_leaves_the_old_file(tmp_path: Path):
    path = tmp_path / "a.mp4"
    path.write_bytes(b"old")

    def failing() -> Iterator[np.ndarray]:
        yield from make_frames(3, 32, 32)
        raise RuntimeError("interrupted")

    with pytest.raises(RuntimeError, match="interrupted"):
        write_movie(path, failing(), 30, "mp4")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_no_frames_and_bad_rates_are_refused(tmp_path: Path):
    with pytest.raises(UsageError, match="at least one frame"):
        write_movie(tmp_path / "a.mp4", [], 30, "mp4")
    for fps in (0, -1, float("nan"), float("inf")):
        with pytest.raises(UsageError, match="frames per second"):
            write_movie(tmp_path / "a.mp4", make_frames(1, 8, 8), fps, "mp4")
    assert not list(tmp_path.iterdir())


def test_a_missing_folder_is_an_output_error(tmp_path: Path):
    with pytest.raises(OutputError, match="nowhere"):
        write_movie(tmp_path / "nowhere" / "a.mp4", make_frames(1, 8, 8), 30, "mp4")


def test_frames_of_other_kinds_are_refused(tmp_path: Path):
    with pytest.raises(ValueError, match="size"):
        write_video(tmp_path / "a.mp4", [*make_frames(1, 16, 16), *make_frames(1, 15, 16)], 30)
    with pytest.raises(ValueError, match="uint8"):
        write_video(tmp_path / "a.mp4", [np.zeros((16, 16, 3))], 30)
