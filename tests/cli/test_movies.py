"""The other moving formats: WebM, WebP, GIF, y4m, raw and PNG streams, decoded again."""

from __future__ import annotations

import io
import sys
import tempfile
import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from styl3r_cli.errors import OutputError, UsageError
from styl3r_cli.movies import FILES, PIPED, write_movie

COUNT, RATE = 9, 24


def make_frames(count: int, width: int, height: int, channels: int = 3) -> Iterator[np.ndarray]:
    """A smooth picture that wanders, so that frames differ and compress."""
    rows, columns = np.mgrid[0:height, 0:width]
    for index in range(count):
        waves = [np.sin((columns + 3 * index) / 17 + c) * np.cos(rows / 13 - c) for c in range(3)]
        picture = (127.5 + 120 * np.stack(waves, axis=-1)).astype(np.uint8)
        if channels == 4:
            alpha = np.full((height, width, 1), 255, np.uint8)
            alpha[:, : width // 2] = 60
            picture = np.concatenate([picture, alpha], axis=2)
        yield picture


def decode(path: Path, form: str = "rgb24") -> list[np.ndarray]:
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format=form) for frame in container.decode(video=0)]


@pytest.mark.parametrize("size", [(64, 48), (63, 47), (1, 1)])
def test_webm_is_vp9_and_decodes_to_its_frames(tmp_path: Path, size: tuple[int, int]) -> None:
    path, (width, height) = tmp_path / "a.webm", size
    assert write_movie(path, make_frames(COUNT, *size), RATE, "webm") == COUNT
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.average_rate) == ("vp9", RATE)
        assert stream.codec_context.colorspace == 1
    decoded = decode(path)
    assert len(decoded) == COUNT
    for picture, original in zip(decoded, make_frames(COUNT, *size), strict=True):
        assert np.abs(picture[:height, :width].astype(int) - original).mean() < 6


def test_webm_keeps_alpha(tmp_path: Path) -> None:
    path = tmp_path / "a.webm"
    write_movie(path, make_frames(3, 64, 48, 4), RATE, "webm")
    with av.open(str(path)) as container:
        assert container.streams.video[0].metadata["ALPHA_MODE"] == "1"
        # FFmpeg's own VP9 decoder drops alpha; libvpx's does not.
        decoder = av.CodecContext.create("libvpx-vp9", "r")
        frames = [f for packet in container.demux(video=0) for f in decoder.decode(packet)]
    alpha = frames[0].to_ndarray(format="rgba")[..., 3]
    assert np.abs(alpha[:, :28].astype(int) - 60).max() < 8
    assert alpha[:, 36:].min() > 247


@pytest.mark.parametrize("channels", [3, 4])
def test_webp_is_animated_and_loops(tmp_path: Path, channels: int) -> None:
    path = tmp_path / "a.webp"
    write_movie(path, make_frames(COUNT, 63, 47, channels), RATE, "webp")
    with Image.open(path) as image:
        assert (image.n_frames, image.size, image.info["loop"]) == (COUNT, (63, 47), 0)
        for index, original in enumerate(make_frames(COUNT, 63, 47, channels)):
            image.seek(index)
            picture = np.asarray(image.convert("RGB" if channels == 3 else "RGBA")).astype(int)
            assert np.abs(picture[:, 32:] - original[:, 32:]).mean() < 6
            if channels == 4:
                assert np.abs(picture[:, :30, 3] - 60).max() < 8


def test_gif_loops_and_keeps_time(tmp_path: Path) -> None:
    path = tmp_path / "a.gif"
    write_movie(path, make_frames(COUNT, 63, 47), RATE, "gif")
    with Image.open(path) as image:
        assert (image.n_frames, image.size, image.info["loop"]) == (COUNT, (63, 47), 0)
        lasted = 0
        for index, original in enumerate(make_frames(COUNT, 63, 47)):
            image.seek(index)
            lasted += image.info["duration"]
            assert np.abs(np.asarray(image.convert("RGB")).astype(int) - original).mean() < 8
    assert lasted == pytest.approx(1000 * COUNT / RATE, abs=6)
    assert len(decode(path)) == COUNT  # FFmpeg reads it too


def test_gif_says_what_it_cannot(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="at most 50 frames"):
        write_movie(tmp_path / "a.gif", make_frames(2, 8, 8), 60, "gif")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["mp4", "gif", "y4m"])
def test_no_alpha_where_there_is_none(tmp_path: Path, kind: str) -> None:
    with pytest.raises(UsageError, match="alpha"):
        write_movie(tmp_path / f"a.{kind}", make_frames(2, 8, 8, 4), RATE, kind)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("size", "matrix"), [((63, 47), "ITU601"), ((1280, 8), "ITU709")])
def test_y4m_says_its_size_and_rate(tmp_path: Path, size: tuple[int, int], matrix: str) -> None:
    path = tmp_path / "a.y4m"
    write_movie(path, make_frames(3, *size), 29.97, "y4m")
    assert path.read_bytes().startswith(b"YUV4MPEG2 W%d H%d F30000:1001 " % size)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.width, stream.height, stream.pix_fmt) == (*size, "yuv444p")
        assert str(stream.average_rate) == "30000/1001"
        frames = [
            f.reformat(format="rgb24", src_colorspace=matrix) for f in container.decode(stream)
        ]
    assert len(frames) == 3
    for frame, original in zip(frames, make_frames(3, *size), strict=True):
        assert np.abs(frame.to_ndarray().astype(int) - original).max() <= 4


@pytest.mark.parametrize("channels", [3, 4])
def test_raw_video_is_the_pixels(tmp_path: Path, channels: int) -> None:
    path = tmp_path / "a.rgb"
    write_movie(path, make_frames(3, 31, 17, channels), RATE, "rgb")
    frames = np.frombuffer(path.read_bytes(), np.uint8).reshape(3, 17, 31, channels)
    np.testing.assert_array_equal(frames, np.stack(list(make_frames(3, 31, 17, channels))))


def test_pngs_follow_each_other(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    write_movie(path, make_frames(3, 31, 17), RATE, "png")
    with av.open(str(path), format="png_pipe") as container:
        decoded = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    np.testing.assert_array_equal(decoded, list(make_frames(3, 31, 17)))
    assert Image.open(io.BytesIO(path.read_bytes())).size == (31, 17)


@pytest.mark.parametrize("kind", [*FILES, *PIPED])
def test_the_same_frames_give_the_same_bytes(tmp_path: Path, kind: str) -> None:
    for name in ("a", "b"):
        write_movie(tmp_path / name, make_frames(4, 48, 32), RATE, kind)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.parametrize("kind", [*FILES, *PIPED])
def test_a_failure_leaves_nothing(tmp_path: Path, kind: str) -> None:
    def failing() -> Iterator[np.ndarray]:
        yield from make_frames(3, 32, 32)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_movie(tmp_path / "a", failing(), RATE, kind)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["gif", "y4m", "rgb", "png"])
def test_memory_does_not_grow_with_the_frames(tmp_path: Path, kind: str) -> None:
    """Of what Python allocates; FFmpeg's encoders have fixed windows of their own."""

    def peak(count: int) -> int:
        tracemalloc.start()
        write_movie(tmp_path / "a", make_frames(count, 64, 64), RATE, kind)
        highest = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return highest

    peak(3)
    frame = 64 * 64 * 3
    assert peak(60) - peak(6) < 5 * frame


@pytest.mark.skipif(sys.platform == "win32", reason="no limit on files' sizes there")
@pytest.mark.usefixtures("capsysbinary")
def test_a_full_temporary_folder_is_not_taken_for_standard_output() -> None:
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
        with pytest.raises(OutputError, match=r"cannot write the video: .*TMPDIR"):
            write_movie(None, make_frames(COUNT, 64, 48), RATE, "gif")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.usefixtures("capsysbinary")
def test_no_temporary_folder_is_no_bug(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where everything is read-only."""
    monkeypatch.setattr(tempfile, "tempdir", None)
    monkeypatch.setattr(tempfile, "_candidate_tempdir_list", lambda: ["/proc/nowhere"])
    with pytest.raises(OutputError, match="No usable temporary directory"):
        write_movie(None, make_frames(COUNT, 64, 48), RATE, "mp4")
