"""COLMAP's reconstructions: cameras, images and points, binary or text, as plain arrays."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.errors import InputError

# COLMAP's camera models in the order of their numbers, and how many parameters each has.
MODELS = {
    "SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8,
    "OPENCV_FISHEYE": 8, "FULL_OPENCV": 12, "FOV": 5, "SIMPLE_RADIAL_FISHEYE": 4,
    "RADIAL_FISHEYE": 5, "THIN_PRISM_FISHEYE": 12,
}  # fmt: skip
FILES = ("cameras", "images", "points3D")

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lens:
    """A camera of the reconstruction: model, size in pixels, and the model's parameters."""

    model: str
    width: int
    height: int
    parameters: tuple[float, ...]


@dataclass(frozen=True)
class Photo:
    """A registered photo.

    Attributes:
        name: its file, relative to the folder of images.
        lens: number of its camera.
        quaternion: (4,) w x y z, world-to-camera.
        translation: (3,) world-to-camera.
        uv: (P, 2) where points were found, pixels; the first pixel's centre is (0.5, 0.5).
        points: (P,) which, -1 for none.
    """

    name: str
    lens: int
    quaternion: Array
    translation: Array
    uv: Array
    points: NDArray[np.int64]


@dataclass
class Reconstruction:
    """Everything that the evaluation needs.

    Attributes:
        lenses: by number.
        photos: in the order of their names.
        points: (3,) each, by number.
    """

    lenses: dict[int, Lens] = field(default_factory=dict)
    photos: list[Photo] = field(default_factory=list)
    points: dict[int, Array] = field(default_factory=dict)


def model_folder(scene: Path) -> Path | None:
    """Where a scene's reconstruction lies: `sparse/0`, `sparse`, or right in it; None for none."""
    for folder in (scene / "sparse" / "0", scene / "sparse", scene):
        for suffix in (".bin", ".txt"):
            if all((folder / f"{name}{suffix}").is_file() for name in FILES):
                return folder
    return None


def read_reconstruction(folder: Path) -> Reconstruction:
    """Read `cameras`, `images` and `points3D`, binary ones if there are any.

    Raises:
        InputError: a file is missing or damaged.
    """
    binary = all((folder / f"{name}.bin").is_file() for name in FILES)
    readers = (_lenses, _photos, _points) if binary else (_text_lenses, _text_photos, _text_points)
    found, path = Reconstruction(), folder
    try:
        for name, reader in zip(FILES, readers, strict=True):
            path = folder / f"{name}{'.bin' if binary else '.txt'}"
            with path.open("rb") as file:
                reader(file, found)
    except (OSError, ValueError, IndexError, KeyError, struct.error) as error:
        raise InputError(f"{path}: not COLMAP's: {error!r}") from error
    found.photos.sort(key=lambda photo: photo.name)
    return found


# ------------------------------------------------------------------ binary, little-endian


def _take(file: BinaryIO, layout: str) -> tuple[int | float, ...]:
    layout = "<" + layout
    return struct.unpack(layout, file.read(struct.calcsize(layout)))


def _count(file: BinaryIO) -> int:
    return int(_take(file, "Q")[0])


def _lenses(file: BinaryIO, found: Reconstruction) -> None:
    names = list(MODELS)
    for _ in range(_count(file)):
        number, model, width, height = (int(v) for v in _take(file, "iiQQ"))
        name = names[model]
        found.lenses[number] = Lens(name, width, height, _take(file, f"{MODELS[name]}d"))


def _photos(file: BinaryIO, found: Reconstruction) -> None:
    entry = np.dtype([("uv", "<f8", 2), ("point", "<i8")])
    for _ in range(_count(file)):
        numbers = _take(file, "i7di")
        name = b"".join(iter(lambda: file.read(1).rstrip(b"\0"), b"")).decode()
        size = _count(file) * entry.itemsize
        table = np.frombuffer(file.read(size), entry)
        if table.nbytes != size:
            raise ValueError(f"ends within {name}")
        pose, lens = np.array(numbers[1:8]), int(numbers[8])
        found.photos.append(Photo(name, lens, pose[:4], pose[4:], table["uv"], table["point"]))


def _points(file: BinaryIO, found: Reconstruction) -> None:
    for _ in range(_count(file)):
        number, *rest = _take(file, "Q3d3BdQ")
        found.points[int(number)] = np.array(rest[:3])
        file.seek(8 * int(rest[-1]), 1)  # the track: pairs of photo and place in it, 4 bytes each


# ------------------------------------------------------------------ text


def _lines(file: BinaryIO) -> Iterator[list[str]]:
    """Words of each line that is no comment; a line may be empty."""
    for line in file:
        if not line.startswith(b"#"):
            yield line.decode().split()


def _text_lenses(file: BinaryIO, found: Reconstruction) -> None:
    for words in filter(None, _lines(file)):
        number, model, width, height, *parameters = words
        if len(parameters) != MODELS[model]:
            raise ValueError(f"{model} has {MODELS[model]} parameters, not {len(parameters)}")
        values = tuple(float(p) for p in parameters)
        found.lenses[int(number)] = Lens(model, int(width), int(height), values)


def _text_photos(file: BinaryIO, found: Reconstruction) -> None:
    lines = _lines(file)
    for words in lines:
        if not words:
            continue
        pose, name = np.array(words[1:8], np.float64), " ".join(words[9:])
        table = np.array(next(lines, []), np.float64).reshape(-1, 3)
        points = table[:, 2].astype(np.int64)
        photo = Photo(name, int(words[8]), pose[:4], pose[4:], table[:, :2], points)
        found.photos.append(photo)


def _text_points(file: BinaryIO, found: Reconstruction) -> None:
    for words in filter(None, _lines(file)):
        found.points[int(words[0])] = np.array(words[1:4], np.float64)
