"""Depth pictures: what is read of them, and what is refused."""

from __future__ import annotations

import io
import pickle
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from styl3r_cli.errors import InputError
from styl3r_cli.photos.depth import read_depth

MILLIMETRES = np.array([[0, 1, 255], [256, 40_000, 65_535]], np.uint16)


def npy(values: np.ndarray) -> bytes:
    data = io.BytesIO()
    np.save(data, values)
    return data.getvalue()


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".npy", ".NPY"])
def test_all_sixteen_bits_are_read(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"depth{suffix}"
    if suffix.lower() == ".npy":
        path.write_bytes(npy(MILLIMETRES))
    else:
        Image.fromarray(MILLIMETRES).save(path)
    np.testing.assert_array_equal(read_depth(path), MILLIMETRES)


def test_metres_are_read(tmp_path: Path) -> None:
    metres = MILLIMETRES.astype(np.float32) / 1000
    picture, array = tmp_path / "depth.tiff", tmp_path / "depth.npy"
    Image.fromarray(metres).save(picture)
    array.write_bytes(npy(metres[..., None].astype(">f8")))
    for path in (picture, array):
        np.testing.assert_allclose(read_depth(path), metres)


class Harmful:
    """Leaves a file behind when it is unpickled."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return Path.touch, (Path("harm"),)


def claimed(shape: str) -> bytes:
    """An array file that says it is larger than it is."""
    return npy(MILLIMETRES).replace(b"(2, 3), }" + b" " * 12, f"{shape}, }}".ljust(21).encode())


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "damaged"),
        (npy(MILLIMETRES)[:-1], "damaged"),
        (claimed("(99999999, 999)"), "larger than"),
        (claimed("(-2, 3)"), "damaged"),
        (npy(np.array([[Harmful()]], object)), "damaged"),
        (pickle.dumps(Harmful()), "damaged"),
        (npy(np.zeros((2, 3, 3))), "numbers (height, width), not float64 (2, 3, 3)"),
        (npy(np.zeros((0, 3))), "numbers"),
        (npy(np.array([["a"]])), "numbers"),
        (npy(np.zeros((2, 2), complex)), "numbers"),
    ],
)
def test_other_arrays_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, data: bytes, told: str
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "depth.npy"
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"depth\.npy: ") as failure:
        read_depth(path)
    assert told in str(failure.value)
    assert not (tmp_path / "harm").exists()


def test_a_damaged_header_is_not_recited(tmp_path: Path) -> None:
    """Found by fuzzing: numpy quotes the header with whatever is in it."""
    path = tmp_path / "depth.npy"
    path.write_bytes(npy(MILLIMETRES).replace(b" " * 40, b"\x8b" * 40))
    with pytest.raises(InputError) as failure:
        read_depth(path)
    assert str(failure.value).count("x8b") < 40


@pytest.mark.parametrize("mode", ["L", "RGB", "LA", "P", "1"])
def test_pictures_for_the_eye_are_refused(tmp_path: Path, mode: str) -> None:
    path = tmp_path / "depth.png"
    Image.new(mode, (3, 2)).save(path)
    with pytest.raises(InputError, match="no depth picture"):
        read_depth(path)


@given(place=st.integers(0, 127), byte=st.integers(0, 255), cut=st.integers(0, 140))
@settings(max_examples=200, deadline=None)
def test_any_damage_is_an_input_error(
    tmp_path_factory: pytest.TempPathFactory, place: int, byte: int, cut: int
) -> None:
    data = bytearray(npy(MILLIMETRES))
    data[place] = byte
    path = tmp_path_factory.getbasetemp() / "damaged.npy"
    path.write_bytes(bytes(data[:cut]))
    with suppress(InputError):
        assert read_depth(path).ndim == 2
