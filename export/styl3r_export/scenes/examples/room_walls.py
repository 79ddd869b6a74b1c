"""The example room's floor, walls, window, curtains, shelf and painting."""

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.builder import Material, SceneBuilder
from styl3r_export.scenes.examples import still_life as still
from styl3r_export.scenes.examples.still_life import paint
from styl3r_export.scenes.examples.woodcut import great_wave
from styl3r_export.scenes.meshes import Mesh, box, merged, quad, surface
from styl3r_export.scenes.patterns import SIDE, planks
from styl3r_export.scenes.solids import blob, tube

#: Height of the table top, and where walls stand.
TABLE, BACK, LEFT, RIGHT, CEILING = 0.74, 1.15, -1.75, 1.85, 2.6


def texture(builder: SceneBuilder, picture: NDArray[np.floating]) -> int:
    """Give the scene a picture (256, 256, 3) in [0, 1]; its texture index."""
    builder.pictures.append((np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8))
    return len(builder.pictures) - 1


def add(builder: SceneBuilder, parts: still.Parts) -> None:
    """Put finished parts into the scene."""
    for mesh, look in parts:
        builder.add(mesh, look)


def wood(builder: SceneBuilder, seed: int, tone: tuple[float, float, float]) -> int:
    """Boards recoloured to a tone (sRGB mean)."""
    picture = planks(np.random.default_rng(seed))
    grey = picture.mean(-1, keepdims=True) / picture.mean()
    return texture(builder, grey**1.2 * np.asarray(tone))


def shell(builder: SceneBuilder) -> None:
    """Floor, walls with panelling, ceiling edge, window and curtains."""
    floor = Material(texture=wood(builder, 4, (0.55, 0.37, 0.23)), scale=1.3, gloss=0.25)
    builder.add(quad((LEFT, -3, 0), (RIGHT - LEFT, 0, 0), (0, 3 + BACK, 0)), floor)
    wall = paint(
        0.86, 0.73, 0.50, stain=0.07, stain_scale=0.5, casts=False, bump=0.06, bump_scale=0.05
    )
    side = paint(0.80, 0.66, 0.44, stain=0.07, stain_scale=0.5, casts=False)
    builder.add(quad((LEFT, BACK, 0), (RIGHT - LEFT, 0, 0), (0, 0, CEILING)), wall)
    builder.add(quad((LEFT, -3, 0), (0, 3 + BACK, 0), (0, 0, CEILING)), side)
    builder.add(quad((RIGHT, BACK, 0), (0, -3 - BACK, 0), (0, 0, CEILING)), side)
    builder.add(
        quad((LEFT, -3, CEILING), (0, 3 + BACK, 0), (RIGHT - LEFT, 0, 0)),
        paint(0.9, 0.88, 0.82, casts=False),
    )
    panel, rail = paint(0.33, 0.46, 0.44, gloss=0.1), paint(0.29, 0.41, 0.40, gloss=0.1)
    builder.add(box((RIGHT - LEFT, 0.02, 0.85), (0, BACK - 0.01, 0.425)), panel)
    rails = [box((RIGHT - LEFT, 0.05, 0.05), (0, BACK - 0.03, z)) for z in (0.86, 0.06)]
    rails += [box((0.05, 0.035, 0.8), (x, BACK - 0.02, 0.45)) for x in np.arange(LEFT, RIGHT, 0.4)]
    builder.add(merged(rails), rail)
    _window(builder, -0.86, 1.62, 0.86, 1.1)


def _window(builder: SceneBuilder, x: float, z: float, wide: float, tall: float) -> None:
    """A bright garden behind glazing bars, between curtains."""
    rng = np.random.default_rng(8)
    v, u = np.mgrid[0:SIDE, 0:SIDE] / SIDE
    hills = 0.62 + 0.07 * np.sin(5 * u + 1) + 0.03 * np.sin(13 * u)
    view = np.where(
        (v < hills)[..., None],
        np.stack([0.62 + 0.3 * v, 0.80 + 0.12 * v, 0.97 - 0.02 * v], -1),
        np.stack([0.45 - 0.2 * v, 0.66 - 0.15 * v, 0.28 + 0 * v], -1),
    )
    for _ in range(60):
        cx, cy, r = rng.uniform(0, 1), rng.uniform(0.55, 1), rng.uniform(0.02, 0.07)
        tree = ((u - cx) ** 2 + (v - cy) ** 2 < r * r)[..., None]
        view = np.where(tree, np.array([0.25, 0.48, 0.2]) * rng.uniform(0.8, 1.3), view)
    view = np.asarray(cv2.GaussianBlur(view, (0, 0), 2.5))
    garden = Material(
        (1.7, 1.7, 1.7), texture(builder, view), scale=tall, glow=True, mirrored=False
    )
    pane = quad((x - wide / 2, BACK - 0.02, z - tall / 2), (wide, 0, 0), (0, 0, tall))
    builder.add(pane, garden)
    white = paint(0.95, 0.93, 0.88, gloss=0.2)
    bars = [box((0.05, 0.08, tall), (x + s * wide / 2, BACK - 0.04, z)) for s in (-1, 1)]
    bars += [box((0.025, 0.05, tall), (x, BACK - 0.04, z))]
    bars += [box((wide + 0.05, 0.08, 0.05), (x, BACK - 0.04, z + s * tall / 2)) for s in (-1, 1)]
    bars += [box((wide, 0.05, 0.025), (x, BACK - 0.04, z + 0.12))]
    bars += [box((wide + 0.2, 0.2, 0.04), (x, BACK - 0.1, z - tall / 2 - 0.03))]
    builder.add(merged(bars), white)
    red = paint(0.70, 0.20, 0.17, stain=0.1, stain_scale=0.3)
    for s in (-1, 1):
        across = np.linspace(0, 1, 60)
        down = np.linspace(0, 1, 12)
        a, d = np.meshgrid(across, down)
        drawn = 0.30 * (1 - 0.25 * np.sin(np.pi * d))
        px = x + s * (wide / 2 + 0.17 - drawn * a)
        py = BACK - 0.11 + 0.03 * np.sin(a * 38) * (0.4 + 0.6 * d)
        builder.add(surface(np.stack([px, py, z + tall / 2 + 0.1 - 1.35 * tall * d], -1)), red)
    pole = np.array([[x - 0.72, BACK - 0.11, z + 0.68], [x + 0.72, BACK - 0.11, z + 0.68]])
    builder.add(tube(pole, 0.014, 10), paint(0.35, 0.22, 0.12, gloss=0.3))


def wall_things(builder: SceneBuilder) -> None:
    """A painting, a shelf with books and pots."""
    frame = [box((0.62, 0.04, 0.05), (0.12, BACK - 0.02, z)) for z in (1.33, 1.78)]
    frame += [box((0.05, 0.04, 0.5), (x, BACK - 0.02, 1.555)) for x in (-0.165, 0.405)]
    builder.add(merged(frame), paint(0.55, 0.38, 0.14, gloss=0.5, sharpness=40.0))
    print_ = cv2.resize(great_wave(), (SIDE, SIDE), interpolation=cv2.INTER_AREA) / 255
    art = Material(texture=texture(builder, print_), scale=1.0, mirrored=False)
    canvas = quad((-0.14, BACK - 0.012, 1.355), (0.52, 0, 0), (0, 0, 0.4))
    builder.add(
        Mesh(canvas.vertices, canvas.normals, (canvas.uvs / [0.52, 0.4]).astype(np.float32)), art
    )
    oak = Material(texture=wood(builder, 9, (0.48, 0.31, 0.18)), scale=0.5)
    x0, y0 = 1.12, BACK - 0.14
    boards = [box((0.95, 0.26, 0.028), (x0, y0, z)) for z in (1.2, 1.58, 1.96)]
    boards += [box((0.028, 0.26, 0.8), (x0 + s * 0.475, y0, 1.58)) for s in (-1, 1)]
    builder.add(merged(boards), oak)
    rng = np.random.default_rng(12)
    tones = [
        (0.62, 0.16, 0.14),
        (0.85, 0.68, 0.35),
        (0.17, 0.27, 0.42),
        (0.25, 0.42, 0.33),
        (0.88, 0.83, 0.72),
        (0.45, 0.24, 0.34),
    ]
    for z, start, stop in ((1.214, 0.68, 1.24), (1.594, 0.98, 1.56)):
        x = start
        while x < stop:
            w, h = rng.uniform(0.02, 0.05), rng.uniform(0.2, 0.31)
            look = paint(*tones[int(rng.integers(6))], gloss=0.15)
            builder.add(box((w, 0.17, h), (x + w / 2, y0, z + h / 2)), look)
            band = box((w + 0.001, 0.172, 0.012), (x + w / 2, y0, z + h * 0.8))
            builder.add(band, paint(0.88, 0.74, 0.4))
            x += w + 0.003
    blue = paint(0.20, 0.36, 0.62, gloss=0.8, sharpness=70.0)
    builder.add(blob((0.075, 0.075, 0.09), None, 24).placed((1.42, y0, 1.3)), blue)
    add(builder, still.teapot(np.array([0.8, y0, 1.594]), 0.5))
    add(builder, still.pot_plant(rng, np.array([1.1, y0, 1.974]), 0.34))
