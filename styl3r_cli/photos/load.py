"""Photos and style pictures, ready for the graphs, with notes on everything that was decided."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.errors import InputError, UsageError
from styl3r_cli.photos.decode import Decoded, decode
from styl3r_cli.photos.expand import name_some
from styl3r_cli.photos.resize import PATCH, detail_size, fit_intrinsics, fit_photo, fit_style
from styl3r_cli.photos.similar import similar_pairs
from styl3r_cli.photos.views import FocalSource, view_intrinsics

MIN_VIEWS, MAX_VIEWS = 2, 8  # what the network was made for
DEFAULT_SIZE = (256, 256)  # what it was trained on
STYLE_SIDE = 256
# Covering a square with a picture longer than this would enlarge it to gigabytes.
MAX_ASPECT = 100
# Each is a Gaussian, and attention grows with their square: few machines can do a quarter of that.
MOST_PIXELS = 4096 * 4096
DECODERS = 2  # full-size photos in memory at once


@dataclass(frozen=True)
class Photos:
    """N views as the structure graph reads them.

    Attributes:
        images: (N, 3, H, W) float32, sRGB in [0, 1].
        intrinsics: (N, 3, 3) float32, normalised by width and height.
        names: N file names, as a person tells the views apart.
        paths: N files.
        sizes: N (width, height) of the photos as shown, before the resize.
        focal_sources: N times where the focal length is from.
        notes: one line each: views chosen or left out, pixels changed, focal lengths assumed.
        details: N times (h, w, 3) uint8, what `images` show in up to twice their size, to find
            features in; without any, `images` themselves are looked at.
    """

    images: NDArray[np.float32]
    intrinsics: NDArray[np.float32]
    names: list[str]
    paths: list[Path]
    sizes: list[tuple[int, int]]
    focal_sources: list[FocalSource]
    notes: list[str]
    details: list[NDArray[np.uint8]] = field(default_factory=list)

    @property
    def focals_measured(self) -> list[bool]:
        """N times whether the focal length was measured, and not guessed."""
        return [source in ("cameras", "fov", "exif") for source in self.focal_sources]


@dataclass(frozen=True)
class Style:
    """A style picture: (3, h, w) float32, sRGB in [0, 1], its file's name, and notes."""

    image: NDArray[np.float32]
    name: str
    notes: list[str]


@dataclass(frozen=True)
class _View:
    """A decoded photo, of which only small crops are kept."""

    path: Path
    pixels: NDArray[np.uint8]
    detail: NDArray[np.uint8]
    size: tuple[int, int]
    equivalent_focal: float | None
    notes: list[str]


def load_photos(
    paths: Sequence[Path],
    size: tuple[int, int] = DEFAULT_SIZE,
    fov: float | None = None,
    cameras: Mapping[Path, Camera] | None = None,
) -> Photos:
    """Decode, turn upright, resize and crop the views, and find their intrinsics.

    Unreadable photos are left out with a note as long as two others remain. Of more than 8, the
    first, the last and 6 evenly spaced ones between are used.

    Args:
        paths: the photos, in the order in which they were taken if there is one.
        size: (height, width) for the network, multiples of 16.
        fov: horizontal field of view in degrees of the photos as shown, for all of them.
        cameras: known intrinsics by path; they beat `fov`, and `fov` beats EXIF.

    Raises:
        InputError: fewer than two photos can be used, or a camera is for another photo shape.
        UsageError: `size` or `fov` makes no sense.
    """
    if any(side < PATCH or side % PATCH for side in size):
        raise UsageError(f"size {size[1]}x{size[0]}: width and height must be multiples of {PATCH}")
    if size[0] * size[1] > MOST_PIXELS:
        raise UsageError(f"size {size[1]}x{size[0]}: at most 4096x4096, or as many pixels")
    if len(paths) < MIN_VIEWS:
        given = "no photo was" if not paths else f"only one photo was given ({paths[0]})"
        raise InputError(f"{given}{'' if paths else ' given'}; a scene needs 2 to 8 views of it")
    notes: list[str] = []
    views = _readable_views(list(paths), size, notes)
    names = _distinct_names([view.path for view in views])
    for view in views:
        notes += view.notes
    notes += _small_notes(views, names, size)
    notes += similar_pairs([view.pixels for view in views], names)
    sizes = [view.size for view in views]
    known = [cameras.get(view.path) if cameras else None for view in views]
    equivalents = [view.equivalent_focal for view in views]
    matrices, sources = view_intrinsics(names, sizes, known, fov, equivalents, notes)
    return Photos(
        images=np.stack([_planes(view.pixels) for view in views]),
        intrinsics=np.stack(
            [fit_intrinsics(*photo, size) for photo in zip(matrices, sizes, strict=True)]
        ),
        names=names,
        paths=[view.path for view in views],
        sizes=sizes,
        focal_sources=sources,
        notes=notes,
        details=[view.detail for view in views],
    )


def load_style(path: Path, side: int = STYLE_SIDE) -> Style:
    """Decode a style picture and crop its centre square, `side` pixels wide.

    Raises:
        InputError: the file is missing, unreadable or absurdly long.
    """
    if not path.exists():
        raise InputError(f"{path}: no such style picture")
    decoded = decode(path)
    _refuse_slivers(path, decoded.image)
    return Style(_planes(fit_style(decoded.image, side)), path.name, decoded.notes)


def spread(count: int, wanted: int) -> list[int]:
    """`wanted` evenly spaced indices below `count`, the first and the last among them."""
    if count <= wanted:
        return list(range(count))
    gaps = wanted - 1
    return [(index * (count - 1) + gaps // 2) // gaps for index in range(wanted)]


def _readable_views(paths: list[Path], size: tuple[int, int], notes: list[str]) -> list[_View]:
    """Up to 8 views; a photo that turns out unreadable gives its place to another."""
    given, unreadable = len(paths), []
    views: dict[int, _View] = {}
    candidates = list(range(given))
    with ThreadPoolExecutor(DECODERS) as pool:
        while True:
            chosen = [candidates[index] for index in spread(len(candidates), MAX_VIEWS)]
            missing = [index for index in chosen if index not in views]
            for index, result in zip(
                missing, pool.map(_attempt(size), [paths[i] for i in missing]), strict=True
            ):
                if isinstance(result, InputError):
                    unreadable.append(str(result))
                    candidates.remove(index)
                else:
                    views[index] = result
            if all(index in views for index in chosen):
                break
    if len(chosen) < MIN_VIEWS:
        usable = f"only {paths[chosen[0]]} can be used" if chosen else "none can be used"
        raise InputError(f"{given} photos, but {usable}: {name_some(unreadable)}")
    notes += [f"left out: {message}" for message in unreadable]
    if len(candidates) > MAX_VIEWS:
        names = ", ".join(_distinct_names([paths[index] for index in chosen]))
        notes.append(f"{len(candidates)} photos, of which {MAX_VIEWS} are used: {names}")
    return [views[index] for index in chosen]


def _attempt(size: tuple[int, int]) -> Callable[[Path], _View | InputError]:
    def read(path: Path) -> _View | InputError:
        try:
            decoded = decode(path)
            _refuse_slivers(path, decoded.image)
        except InputError as error:
            return error
        return _view(path, decoded, size)

    return read


def _view(path: Path, decoded: Decoded, size: tuple[int, int]) -> _View:
    # Copies let go of the uncropped pictures.
    pixels = fit_photo(decoded.image, size).copy()
    detail = fit_photo(decoded.image, detail_size(decoded.image.size, size)).copy()
    return _View(path, pixels, detail, decoded.image.size, decoded.equivalent_focal, decoded.notes)


def _refuse_slivers(path: Path, image: Image.Image) -> None:
    shorter, longer = sorted(image.size)
    if longer > MAX_ASPECT * shorter:
        raise InputError(f"{path}: {image.width}x{image.height} pixels is too narrow to be used")


def _small_notes(views: list[_View], names: list[str], size: tuple[int, int]) -> list[str]:
    height, width = size
    small = [
        f"{name} ({view.size[0]}x{view.size[1]})"
        for view, name in zip(views, names, strict=True)
        if view.size[0] < width or view.size[1] < height
    ]
    return [f"smaller than {width}x{height}, so enlarged: {name_some(small)}"] if small else []


def _distinct_names(paths: list[Path]) -> list[str]:
    names = [path.name for path in paths]
    return names if len(set(names)) == len(names) else [str(path) for path in paths]


def _planes(pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(H, W, 3) uint8 to (3, H, W) float32 in [0, 1]."""
    return np.ascontiguousarray(pixels.transpose(2, 0, 1), dtype=np.float32) / np.float32(255)
