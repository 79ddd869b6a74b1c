"""One picture that tells a person whether it worked: photos, style, result, novel view, depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from PIL import Image

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.poses import blend, from_camera, to_camera
from styl3r_cli.contact_sheet import Cell, Row, draw_sheet
from styl3r_cli.depth_colours import SOLID, colour_depths
from styl3r_cli.files import atomic_write
from styl3r_cli.frames import Drawing, Picture, enlarged, to_picture
from styl3r_cli.gaussians import FloatArray, Gaussians
from styl3r_cli.photos.load import spread

MOST_VIEWS = 4  # more columns than this get too small to judge on a screen
CELL = 256  # pixels of a picture's longer side, at least


@dataclass(frozen=True)
class Preview:
    """What the sheet shows.

    Attributes:
        images: (N, 3, H, W) the views, sRGB in [0, 1].
        names: N photo names.
        styles: style pictures (3, h, w), sRGB in [0, 1]; none for a reconstruction.
        style_names: as many names.
        result: the scene as it was written.
        own: the same scene in its own colours.
        cameras: N, of the views.
    """

    images: FloatArray
    names: Sequence[str]
    styles: Sequence[FloatArray]
    style_names: Sequence[str]
    result: Gaussians
    own: Gaussians
    cameras: Sequence[Camera]


def write_preview(path: Path, preview: Preview, title: str, threads: int | None = None) -> None:
    """Draw the sheet and write it as PNG.

    Up to 4 views are columns; the last column is the style, and a view between the first two.

    Args:
        path: where to write.
        preview: what to show.
        title: the sheet's first line.
        threads: for rendering; None for every core.

    Raises:
        OutputError: the file cannot be written.
    """
    sheet = draw_sheet(title, _rows(preview, threads))
    with atomic_write(path) as temporary, temporary.open("wb") as file:  # may be a pipe
        sheet.save(file, format="PNG")


def _rows(preview: Preview, threads: int | None) -> list[Row]:
    drawing = Drawing(threads=threads)
    shown = spread(len(preview.names), MOST_VIEWS)
    cameras = [enlarged(preview.cameras[index], CELL) for index in shown]
    cameras.append(_between(cameras[0], cameras[1]))
    captions = [f"view {index + 1}" for index in shown]
    captions.append(f"between {captions[0]} and {captions[1]}")
    result = [drawing.frame(preview.result, camera) for camera in cameras]
    depths = colour_depths(
        [frame.depth for frame in result], [frame.alpha > SOLID for frame in result]
    )
    size = cameras[0].width, cameras[0].height
    photos = [Cell(_photo(preview.images[i], size), preview.names[i]) for i in shown]
    if preview.styles:
        photos.append(Cell(_styles(preview.styles, size), ", ".join(preview.style_names)))
    rows = [Row("Photos and style" if preview.styles else "Photos", photos)]
    pictures = [to_picture(frame.colour) for frame in result]
    rows.append(Row("Stylized" if preview.styles else "Scene", _cells(pictures, captions)))
    if preview.styles:
        frames = [drawing.frame(preview.own, camera) for camera in cameras]
        pictures = [to_picture(frame.colour) for frame in frames]
        rows.append(Row("In its own colours", _cells(pictures, captions)))
    rows.append(Row("Depth (red is near, blue is far)", _cells(depths, captions)))
    return rows


def _cells(pictures: Sequence[Picture], captions: Sequence[str]) -> list[Cell]:
    return [Cell(*pair) for pair in zip(pictures, captions, strict=True)]


def _between(first: Camera, second: Camera) -> Camera:
    """The camera halfway between two."""
    return to_camera(blend(from_camera(first), from_camera(second), 0.5), first)


def _photo(planes: FloatArray, size: tuple[int, int]) -> Picture:
    """(3, H, W) floats as a picture of (width, height)."""
    image = Image.fromarray(to_picture(planes.transpose(1, 2, 0)))
    return np.asarray(image.resize(size, Image.Resampling.LANCZOS))


def _styles(styles: Sequence[FloatArray], size: tuple[int, int]) -> Picture:
    """The style picture in a square; of several, a strip each, side by side."""
    side = min(size)
    cell = Image.new("RGB", size, "white")
    left, top = (size[0] - side) // 2, (size[1] - side) // 2
    edges = [side * index // len(styles) for index in range(len(styles) + 1)]
    for style, (start, end) in zip(styles, pairwise(edges), strict=True):
        middle = (side - (end - start)) // 2
        strip = Image.fromarray(_photo(style, (side, side))[:, middle : middle + end - start])
        cell.paste(strip, (left + start, top))
    return np.asarray(cell)
