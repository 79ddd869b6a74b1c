"""Pointillism: a river bank on a sunny afternoon in pure dots."""

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.examples.brush import FINER, Picture
from styl3r_export.scenes.examples.oils import HEIGHT, WIDTH, H, W, coordinates, rolling
from styl3r_export.scenes.noise import spectral


def _motif(rng: np.random.Generator) -> Picture:
    """Water, far bank, sails, a lawn in light and shade, trees, strollers with parasols."""
    x, y = coordinates()
    image = np.empty((H, W, 3), np.float32)
    sky = np.clip(y / 0.26, 0, 1)[..., None]
    image[:] = (1 - sky) * np.array([0.60, 0.78, 0.95]) + sky * np.array([0.99, 0.90, 0.78])
    bank = (y > 0.22 - 0.05 * np.abs(np.sin(6 * x) * np.sin(2.3 * x + 1))) & (y < 0.29)
    image[bank] = [0.42, 0.56, 0.42]
    water = (y >= 0.29) & (y < 0.52 + 0.10 * (x - 0.6))
    glint = 0.5 + 0.5 * np.sin(150 * y + 4 * rolling(rng, 1.4))[..., None]
    blue = glint * np.array([0.55, 0.76, 0.90]) + (1 - glint) * np.array([0.26, 0.50, 0.76])
    image = np.where(water[..., None], blue, image)
    lawn = y >= 0.52 + 0.10 * (x - 0.6)
    shade = (y > 0.74 + 0.05 * np.sin(5 * x + 1) + 0.03 * np.sin(13 * x))[..., None]
    grass = np.where(shade, [0.22, 0.42, 0.34], [0.82, 0.82, 0.36])
    image = np.where(lawn[..., None], grass, image).astype(np.float32)

    def shape(points: list[tuple[float, float]], colour: tuple) -> None:
        cv2.fillPoly(image, [(np.array(points) * H).astype(np.int32)], colour)

    def oval(cx: float, cy: float, rx: float, ry: float, colour: tuple) -> None:
        centre, axes = (int(cx * H), int(cy * H)), (int(rx * H), int(ry * H))
        cv2.ellipse(image, centre, axes, 0, 0, 360, colour, -1)

    for sx, sy, size in ((0.30, 0.36, 0.11), (0.52, 0.31, 0.06), (0.80, 0.40, 0.14)):
        shape([(sx, sy - size), (sx, sy), (sx + 0.55 * size, sy)], (0.99, 0.96, 0.88))
        shape(
            [(sx - 0.02, sy - 0.7 * size), (sx - 0.02, sy), (sx - 0.35 * size, sy)],
            (0.98, 0.86, 0.72),
        )
        hull = [(sx - 0.4 * size, sy), (sx + 0.6 * size, sy), (sx + 0.4 * size, sy + 0.14 * size)]
        shape(hull, (0.55, 0.25, 0.22))
    for tx, foot, r in ((0.06, 0.80, 0.21), (1.16, 0.72, 0.24), (0.97, 0.60, 0.10)):
        trunk = 0.1 * r
        shape(
            [
                (tx - trunk, foot),
                (tx + trunk, foot),
                (tx + 0.6 * trunk, foot - 2.2 * r),
                (tx - 0.6 * trunk, foot - 2.2 * r),
            ],
            (0.36, 0.24, 0.30),
        )
        for _ in range(34):
            a, d = rng.uniform(0, 2 * np.pi), r * np.sqrt(rng.uniform(0, 1))
            cx, cy = tx + d * np.cos(a), foot - 2.5 * r + 0.8 * d * np.sin(a)
            lit = np.clip(0.5 - np.sin(a) * d / r * 0.5 + 0.2 * np.cos(a), 0, 1)
            green = lit * np.array([0.68, 0.74, 0.26]) + (1 - lit) * np.array([0.14, 0.34, 0.34])
            oval(cx, cy, 0.28 * r, 0.22 * r, tuple(green.tolist()))
    figures = [
        (0.42, 0.93, 0.30, (0.30, 0.16, 0.38), (0.92, 0.36, 0.22)),
        (0.55, 0.90, 0.26, (0.16, 0.18, 0.34), None),
        (0.78, 0.76, 0.19, (0.86, 0.46, 0.52), (0.98, 0.90, 0.66)),
        (0.24, 0.72, 0.14, (0.72, 0.26, 0.24), None),
    ]
    for fx, fy, tall, dress, parasol in figures:
        cv2.ellipse(
            image,
            (int((fx + 0.4 * tall) * H), int(fy * H)),
            (int(0.45 * tall * H), int(0.05 * tall * H)),
            0,
            0,
            360,
            (0.25, 0.36, 0.45),
            -1,
        )
        shape(
            [
                (fx - 0.20 * tall, fy),
                (fx + 0.20 * tall, fy),
                (fx + 0.07 * tall, fy - 0.52 * tall),
                (fx - 0.07 * tall, fy - 0.52 * tall),
            ],
            dress,
        )
        shape(
            [
                (fx - 0.10 * tall, fy - 0.45 * tall),
                (fx + 0.10 * tall, fy - 0.45 * tall),
                (fx + 0.08 * tall, fy - 0.80 * tall),
                (fx - 0.08 * tall, fy - 0.80 * tall),
            ],
            dress,
        )
        oval(fx, fy - 0.87 * tall, 0.06 * tall, 0.075 * tall, (0.95, 0.74, 0.58))
        oval(fx, fy - 0.94 * tall, 0.09 * tall, 0.035 * tall, (0.24, 0.14, 0.16))
        if parasol:
            px, py = fx + 0.12 * tall, fy - 1.06 * tall
            cv2.ellipse(
                image,
                (int(px * H), int(py * H)),
                (int(0.30 * tall * H), int(0.2 * tall * H)),
                0,
                180,
                360,
                parasol,
                -1,
            )
            cv2.line(
                image,
                (int(px * H), int(py * H)),
                (int((fx + 0.1 * tall) * H), int((fy - 0.6 * tall) * H)),
                (0.3, 0.2, 0.2),
                4,
            )
    return image


def pointillist() -> NDArray[np.uint8]:
    """A river bank in dots of pure colour."""
    rng = np.random.default_rng(29)
    motif = cv2.GaussianBlur(_motif(rng), (0, 0), 3)
    canvas = np.empty((H, W, 3), np.uint8)
    canvas[:] = np.array([0.93, 0.87, 0.74]) * 255
    for radius, gap in ((8.0, 11.0), (6.5, 8.5), (5.0, 8.0)):
        count = int(W * H / gap**2)
        xs, ys = _even(rng, count)
        for px, py in zip(xs, ys, strict=True):
            colour = motif[min(int(py), H - 1), min(int(px), W - 1)]
            dot = _pure(rng, colour)
            r = int(radius * rng.uniform(0.8, 1.15) * 8)
            at = int(px * 8), int(py * 8)
            cv2.circle(canvas, at, r, (np.clip(dot, 0, 1) * 255).tolist(), -1, cv2.LINE_AA, 3)
    grain = spectral(rng, (H, W), 0.4)[..., None]
    picture = np.clip(canvas * (1 + 0.025 * grain), 0, 255).astype(np.float32)
    small = cv2.resize(picture, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    assert picture.shape[0] == HEIGHT * FINER
    return small.astype(np.uint8)


def _even(rng: np.random.Generator, count: int) -> tuple[NDArray, NDArray]:
    """Well-spread positions (a jittered additive recurrence) in random order."""
    k = rng.permutation(count) + rng.uniform(0, 1)
    x = (k * 0.7548776662466927) % 1 * W + rng.normal(0, 1.5, count)
    y = (k * 0.5698402909980532) % 1 * H + rng.normal(0, 1.5, count)
    return np.clip(x, 0, W - 1), np.clip(y, 0, H - 1)


def _pure(rng: np.random.Generator, colour: Picture) -> NDArray[np.float64]:
    """A dot's colour: more vivid than the motif, its neighbours on the wheel, or the opposite."""
    grey = float(colour.mean())
    vivid = grey + (colour - grey) * rng.uniform(1.2, 1.8)
    kind = rng.random()
    if kind < 0.14:  # the complement, lightened
        return np.asarray(0.25 + 0.75 * (2 * grey - vivid) + rng.normal(0, 0.05, 3))
    if kind < 0.34:  # warm light or violet shade strewn everywhere
        accent = np.array([0.99, 0.80, 0.35]) if grey > 0.5 else np.array([0.35, 0.28, 0.62])
        return 0.55 * vivid + 0.45 * accent
    return np.asarray(vivid * np.exp(rng.normal(0, 0.10)) + rng.normal(0, 0.06, 3))
