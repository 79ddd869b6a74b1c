"""Rendered pictures in 8 bits: what each shows, along a path of cameras, and as files."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.depth_colours import COLOUR_MAPS, SOLID, DepthScale
from styl3r_cli.files import atomic_write
from styl3r_cli.gaussians import FloatArray, Gaussians
from styl3r_cli.surroundings import fill_holes

if TYPE_CHECKING:
    from styl3r_cli.splatting import Frame

Picture = NDArray[np.uint8]
Colour = tuple[float, float, float]
BLACK: Colour = (0.0, 0.0, 0.0)
# Instead of a colour: what the scene shows around its holes, blurred into them.
SURROUNDINGS: Literal["surroundings"] = "surroundings"
Background = Colour | Literal["surroundings"]
# One picture: of a camera, at a share of the path's time from 0 up to 1.
Look = Callable[[Camera, float], Picture]

# Frames, and their longer side in pixels, that tell the depths of a whole video.
SCALE_FRAMES, SCALE_SIDE = 12, 128
# The line between two scenes in a wipe: this share of the picture's width, white.
WIPE_LINE = 0.004
LEAST_ALPHA = 0.5 / 255  # fainter is not there in 8 bits
JPEG_QUALITY = 95  # no artefact to be seen, at a third of a PNG


@dataclass
class Tally:
    """What was drawn of a scene.

    Attributes:
        frames: how many.
        empty: how many of them show nothing of it.
    """

    frames: int = 0
    empty: int = 0

    def add(self, alpha: FloatArray) -> None:
        """Count a frame (H, W)."""
        self.frames += 1
        self.empty += not (alpha >= LEAST_ALPHA).any()


@dataclass(frozen=True)
class Drawing:
    """How scenes are drawn: what every frame has in common.

    Attributes:
        background: what is seen where no Gaussian is: sRGB in [0, 1], or SURROUNDINGS; None
            leaves it transparent.
        threads: None for every core.
        antialias: whether Gaussians smaller than a pixel are as faint as they are.
        tally: counts the frames, if there is one.
    """

    background: Background | None = SURROUNDINGS
    threads: int | None = None
    antialias: bool = False
    tally: Tally | None = None

    def frame(self, gaussians: Gaussians, camera: Camera) -> Frame:
        """What the renderer makes of it; the surroundings are in its colours, not in its alpha."""
        from styl3r_cli.splatting import render

        filled = self.background == SURROUNDINGS
        colour = None if self.background == SURROUNDINGS else self.background
        frame = render(gaussians, camera, colour, threads=self.threads, antialias=self.antialias)
        if self.tally is not None:
            self.tally.add(frame.alpha)
        return replace(frame, colour=fill_holes(frame.colour, frame.alpha)) if filled else frame


def to_picture(colours: FloatArray) -> Picture:
    """(H, W, C) sRGB floats to 8 bits: clipped to [0, 1] and rounded."""
    return np.rint(np.clip(colours, 0, 1) * 255).astype(np.uint8)


def colours(gaussians: Gaussians, drawing: Drawing) -> Look:
    """The scene itself; red, green, blue, and straight alpha if there is no background."""

    def look(camera: Camera, _time: float) -> Picture:
        frame = drawing.frame(gaussians, camera)
        if drawing.background is not None:
            return to_picture(frame.colour)
        alpha = frame.alpha[..., None]
        straight = np.divide(frame.colour, alpha, out=np.zeros_like(frame.colour), where=alpha > 0)
        return to_picture(np.concatenate([straight, alpha], axis=2))

    return look


def depths(
    gaussians: Gaussians,
    drawing: Drawing,
    cameras: Sequence[Camera],
    colour_map: str = COLOUR_MAPS[0],
) -> Look:
    """The scene's depth in colours, on one scale for all cameras of the path."""
    drawing = replace(drawing, background=None)
    sampled = [cameras[i] for i in np.linspace(0, len(cameras) - 1, SCALE_FRAMES).astype(int)]
    uncounted = replace(drawing, tally=None)
    frames = [uncounted.frame(gaussians, reduced(camera, SCALE_SIDE)) for camera in sampled]
    solid = [frame.alpha > SOLID for frame in frames]
    scale = DepthScale.of([frame.depth for frame in frames], solid)

    def look(camera: Camera, _time: float) -> Picture:
        frame = drawing.frame(gaussians, camera)
        return scale.picture(frame.depth, frame.alpha > SOLID, colour_map)

    return look


def coarse(look: Look, share: float) -> Look:
    """A look of frames whose sides are that share of what they should be, then enlarged."""
    if share == 1:
        return look
    from PIL import Image

    def enlarge(camera: Camera, time: float) -> Picture:
        size = camera.width, camera.height
        small = camera.resized(*(max(round(side * share), 1) for side in size))
        picture = Image.fromarray(look(small, time))
        return np.asarray(picture.resize(size, Image.Resampling.BICUBIC))

    return enlarge


def side_by_side(left: Look, right: Look) -> Look:
    """Two pictures, one beside the other."""
    return lambda camera, time: np.concatenate([left(camera, time), right(camera, time)], axis=1)


def wipe(left: Look, right: Look) -> Look:
    """Two pictures in one, parted by an upright line that goes from the middle to both sides."""

    def look(camera: Camera, time: float) -> Picture:
        width = camera.width
        edge = round(width * (0.5 - 0.5 * math.sin(2 * math.pi * time)))
        line = max(round(width * WIPE_LINE), 1)
        picture = right(camera, time).copy()
        picture[:, :edge] = left(camera, time)[:, :edge]
        if 0 < edge < width:
            picture[:, max(edge - line, 0) : edge + line] = 255
        return picture

    return look


def draw(
    look: Look, cameras: Sequence[Camera], drawn: Callable[[], None] = lambda: None
) -> Iterator[Picture]:
    """The pictures along a path, one at a time (they need not be in memory together).

    Args:
        look: what to show.
        cameras: one per picture.
        drawn: called after each picture.
    """
    for index, camera in enumerate(cameras):
        yield look(camera, index / len(cameras))
        drawn()


def draw_path(
    gaussians: Gaussians,
    cameras: Iterable[Camera],
    background: Background = SURROUNDINGS,
    threads: int | None = None,
    drawn: Callable[[], None] = lambda: None,
) -> Iterator[Picture]:
    """The pictures that cameras see of a scene, one at a time."""
    yield from draw(colours(gaussians, Drawing(background, threads)), list(cameras), drawn)


def write_picture(path: Path, picture: Picture, kind: str) -> None:
    """Write one picture; it appears whole or not at all.

    Args:
        path: where to write.
        picture: (H, W, 3) uint8 sRGB, or (H, W, 4) with straight alpha.
        kind: "png", which alone keeps alpha, or "jpg".

    Raises:
        OutputError: it cannot be written.
    """
    from PIL import Image

    options: dict[str, Any] = {"format": "PNG"}
    if kind != "png":
        options = {"format": "JPEG", "quality": JPEG_QUALITY, "subsampling": "4:4:4"}
    with atomic_write(path) as temporary, temporary.open("wb") as file:  # may be a pipe
        Image.fromarray(picture).save(file, **options)


def enlarged(camera: Camera, side: int) -> Camera:
    """The same view with its longer side `side` pixels, at least its own; both sides even."""
    factor = max(side / max(camera.width, camera.height), 1.0)
    width, height = (2 * round(length * factor / 2) for length in (camera.width, camera.height))
    return camera.resized(width, height)


def reduced(camera: Camera, side: int) -> Camera:
    """The same view with its longer side at most `side` pixels."""
    factor = min(side / max(camera.width, camera.height), 1.0)
    return camera.resized(*(max(round(s * factor), 1) for s in (camera.width, camera.height)))
