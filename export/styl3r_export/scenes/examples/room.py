"""The example room: a laid table by a window, photographed from four places."""

import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.builder import Light, Material, SceneBuilder
from styl3r_export.scenes.examples import still_life as still
from styl3r_export.scenes.examples.room_walls import (
    BACK,
    TABLE,
    add,
    shell,
    texture,
    wall_things,
    wood,
)
from styl3r_export.scenes.examples.still_life import curve, paint
from styl3r_export.scenes.lighting import light_maps, look_at
from styl3r_export.scenes.meshes import box, merged, spin, surface
from styl3r_export.scenes.patterns import SIDE
from styl3r_export.scenes.photometry import Shot, develop
from styl3r_export.scenes.render import render
from styl3r_export.scenes.solids import blob, cylinder, tube
from styl3r_export.scenes.textures import TextureBank

Vector = NDArray[np.float64]
#: Pixels of the photographs, and how much finer they are rendered.
WIDTH, HEIGHT, FINER = 640, 480, 2
#: 35 mm equivalent focal length (by diagonals, CIPA DCG-001): a phone's main camera.
FOCAL_35MM, FRAME_DIAGONAL = 28.0, 43.267
#: Where the photographer stood (metres; the table's middle is the origin, y towards the wall).
EYES = [(-0.48, -1.72, 1.42), (-0.17, -1.80, 1.47), (0.15, -1.79, 1.43), (0.47, -1.7, 1.48)]
#: The point everyone looks at.
TARGET = np.array([0.02, 0.12, 0.86])
#: Exposure for the tone curve, found by eye.
EXPOSURE = 0.62


def _furniture(builder: SceneBuilder) -> None:
    """The table with its cloth, two chairs, a rug and a tall plant."""
    oak = Material(
        texture=wood(builder, 21, (0.56, 0.36, 0.20)), scale=0.8, gloss=0.3, sharpness=40.0
    )
    legs = [
        box((0.06, 0.06, TABLE - 0.03), (sx * 0.66, sy * 0.38, TABLE / 2 - 0.015))
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    legs += [box((1.3, 0.03, 0.09), (0, s * 0.38, TABLE - 0.08)) for s in (-1, 1)]
    builder.add(merged([box((1.5, 0.92, 0.035), (0, 0, TABLE - 0.0175)), *legs]), oak)
    checks = texture(builder, _gingham())
    cloth = Material(texture=checks, scale=0.16, mirrored=False, bump=0.1, bump_scale=0.05)
    a, b = np.meshgrid(np.linspace(-0.46, 0.46, 40), np.linspace(-1, 1, 60))
    along = np.clip(b * 0.62, -0.465, 0.465)
    fall = np.maximum(np.abs(b * 0.62) - 0.465, 0)
    sway = np.sign(b) * np.minimum(fall * 4, 1) * (0.012 + 0.012 * np.sin(a * 30))
    points = np.stack([a * 0.9, along + sway, TABLE + 0.004 - fall], -1)
    builder.add(surface(points, np.stack([a * 0.9, b * 0.62], -1)), cloth)
    seat = Material(texture=wood(builder, 30, (0.42, 0.24, 0.13)), scale=0.4, gloss=0.2)
    for at, turn in (((0.72, 0.74, 0.0), 0.25), ((-1.1, 0.1, 0.0), 1.75)):
        posts = [
            box((0.035, 0.035, 0.45), (x, y, 0.225)) for x in (-0.19, 0.19) for y in (-0.19, 0.19)
        ]
        posts += [box((0.035, 0.035, 0.5), (x, 0.19, 0.7)) for x in (-0.19, 0.19)]
        posts += [box((0.4, 0.025, 0.06), (0, 0.19, z)) for z in (0.62, 0.77, 0.92)]
        posts.append(box((0.44, 0.44, 0.035), (0, 0, 0.46)))
        builder.add(merged(posts).placed(at, spin(turn)), seat)
    cushion = blob((0.2, 0.2, 0.04), None, 18, 0.5).placed((-1.1, 0.1, 0.51), spin(0.2))
    builder.add(cushion, paint(0.78, 0.55, 0.22, bump=0.2, bump_scale=0.05))
    woven = texture(builder, _rings(np.random.default_rng(3)))
    rug = Material(texture=woven, scale=2.5, mirrored=False, bump=0.3, bump_scale=0.02)
    builder.add(cylinder(1.25, 0.012, sides=64).placed((0, -0.1, 0)), rug)
    add(builder, still.pot_plant(np.random.default_rng(5), np.array([-1.42, 0.82, 0.0]), 0.95))


def _rings(rng: np.random.Generator) -> NDArray[np.floating]:
    """A round rug's coloured rings about the picture's corner, where the disc's middle is."""
    t = (np.arange(SIDE) + 0.5) / SIDE
    t = np.minimum(t, 1 - t) * 2
    ring = (np.hypot(t[:, None], t[None]) * 11).astype(int)
    wool = np.array([[0.80, 0.72, 0.56], [0.62, 0.25, 0.20], [0.23, 0.33, 0.42]])
    return wool[ring % 3] * (1 + 0.08 * rng.normal(size=(SIDE, SIDE, 1)))


def _gingham() -> NDArray[np.floating]:
    """Red and white checks with a thread's texture."""
    t = (np.arange(SIDE) * 4 // SIDE) % 2
    mix = (t[:, None] + t[None]) / 2
    thread = 1 + 0.05 * np.sin(np.arange(SIDE) * np.pi)[None, :, None]
    return (
        np.array([0.95, 0.93, 0.88]) + mix[..., None] * (np.array([0.72, 0.2, 0.2]) - 0.93)
    ) * thread


def _table_things(builder: SceneBuilder) -> None:
    rng = np.random.default_rng(2)
    china = paint(0.93, 0.93, 0.95, gloss=0.9, sharpness=90.0)
    add(
        builder,
        still.flowers(
            rng, np.array([-0.2, 0.2, TABLE]), paint(0.86, 0.89, 0.95, gloss=0.9, sharpness=80.0)
        ),
    )
    add(builder, still.fruit_bowl(rng, np.array([0.2, 0.02, TABLE + 0.005])))
    add(builder, still.teapot(np.array([-0.13, -0.15, TABLE + 0.005]), 0.5))
    add(builder, still.cup(np.array([0.06, -0.3, TABLE + 0.005]), -0.6, china))
    add(builder, still.cup(np.array([-0.38, -0.27, TABLE + 0.005]), 2.4, china))
    add(builder, still.books(np.array([0.53, -0.12, TABLE]), 0.5))
    add(builder, still.lamp(np.array([0.56, 0.28, TABLE])))
    add(builder, still.cat(np.array([-0.55, 0.14, TABLE]), -1.15))
    spoon = curve([(0, 0, 0.006), (0.05, 0, 0.01), (0.12, 0, 0.006)], 8)
    head = blob((0.022, 0.014, 0.004), None, 12).placed((0.135, 0, 0.006))
    silver = paint(0.75, 0.75, 0.77, gloss=1.0, sharpness=60.0)
    builder.add(
        merged([tube(spoon, 0.003, 8), head]).placed((0.13, -0.36, TABLE + 0.006), spin(0.5)),
        silver,
    )


def _lights(builder: SceneBuilder) -> None:
    builder.ambient = np.array([[0.34, 0.36, 0.40], [0.24, 0.19, 0.14]])
    sun, middle = np.array([-7.0, -5.0, 9.0]), np.array([0.0, 0.0, 0.7])
    builder.lights.append(Light(sun, middle, 0.36, np.array([1.25, 1.1, 0.85]), False, 1.6))
    window = np.array([-1.0, BACK - 0.15, 1.9])
    toward = np.array([0.1, -0.4, 0.7])
    builder.lights.append(Light(window, toward, 2.3, np.array([0.55, 0.68, 0.85]), True, 6.0))
    bulb = np.array([0.56, 0.28, TABLE + 0.40])
    builder.lights.append(
        Light(bulb, bulb * [1, 1, 0], 2.5, np.array([0.13, 0.085, 0.04]), True, 5.0)
    )


def photographs() -> list[NDArray[np.uint8]]:
    """Four photographs of the room, (480, 640, 3) uint8 sRGB, from left to right."""
    builder = SceneBuilder(np.random.default_rng(1), TextureBank.procedural(0, 1))
    for build in (shell, wall_things, _furniture, _table_things, _lights):
        build(builder)
    scene = builder.finished()
    low, high = np.array([-0.9, -0.7, 0.4]), np.array([0.9, 0.7, 1.6])
    maps = light_maps(scene, low, high)
    width, height = WIDTH * FINER, HEIGHT * FINER
    focal = FOCAL_35MM / FRAME_DIAGONAL * float(np.hypot(width, height))
    lens = (focal, focal, width / 2, height / 2)
    photos = []
    for k, eye in enumerate(EYES):
        rng = np.random.default_rng([7, k])
        aim = TARGET + rng.normal(0, 0.02, 3)
        extrinsics = look_at(np.array(eye), aim, float(rng.normal(0, 0.015)))
        linear = render(scene, maps, extrinsics, lens, (height, width))[0]
        linear = linear.reshape(HEIGHT, FINER, WIDTH, FINER, 3).mean((1, 3))
        gain = EXPOSURE * float(np.exp(rng.normal(0, 0.03)))
        shot = Shot((gain, gain, gain), vignette=0.12, contrast=1.12, sharpen=0.3, noise=0.006)
        image = develop(linear.astype(np.float32), shot, rng)
        photos.append((image * 255 + 0.5).astype(np.uint8))
    return photos
