"""Ink wash: mountains in mist, a pine, a boat, a red seal."""

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.examples.brush import Picture
from styl3r_export.scenes.examples.oils import ASPECT, HEIGHT, WIDTH, H, W, coordinates, rolling
from styl3r_export.scenes.examples.still_life import curve
from styl3r_export.scenes.noise import spectral

#: Ink and paper, sRGB.
SOOT, PAPER = np.array([0.10, 0.10, 0.11]), np.array([0.93, 0.90, 0.82])


def _ridge(
    rng: np.random.Generator, level: float, height: float, peaks: int
) -> NDArray[np.float64]:
    """(W,) y of a mountain line: a few steep peaks with ragged detail."""
    x = np.linspace(0, ASPECT, W)
    line = np.full(W, level)
    for _ in range(peaks):
        at, wide, tall = (
            rng.uniform(0, ASPECT),
            rng.uniform(0.06, 0.2),
            height * rng.uniform(0.4, 1),
        )
        line = np.minimum(line, level - tall * np.exp(-(np.abs((x - at) / wide) ** 1.3)))
    for octave in range(6):
        knots = rng.normal(0, 1, 6 * 2**octave + 2)
        wave = np.interp(x, np.linspace(0, ASPECT, len(knots)), knots)
        line += wave * 0.016 / 1.7**octave
    return line


def _brush_line(
    rng: np.random.Generator,
    ink: Picture,
    path: NDArray[np.float64],
    widths: NDArray,
    strength: float,
) -> None:
    """A pointed brush: tapered, drier towards the end, with hairs that split."""
    layer = np.zeros_like(ink)
    ahead = np.gradient(path, axis=0)
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    side = np.stack([-ahead[:, 1], ahead[:, 0]], 1)
    hairs = max(int(widths.max() * H / 2.2), 1)
    for k in range(hairs):
        across = (k + 0.5) / hairs - 0.5
        line = path + side * (across * widths)[:, None]
        dry = int(len(path) * rng.uniform(0.6, 1.25))
        points = [np.round(line[: max(dry, 2)] * H * 8).astype(np.int32)]
        cv2.polylines(layer, points, False, strength * rng.uniform(0.7, 1.0), 3, cv2.LINE_8, 3)
    np.maximum(ink, cv2.GaussianBlur(layer, (0, 0), 0.9), out=ink)


def _pine(rng: np.random.Generator, ink: Picture, root: tuple, tall: float) -> None:
    """A leaning trunk, bent boughs, fans of needles."""
    x, y = root
    lean = tall * rng.uniform(-0.25, 0.25)
    trunk = curve(
        [
            (x, y),
            (x + 0.35 * lean, y - 0.35 * tall),
            (x + 0.5 * lean - 0.03 * tall, y - 0.7 * tall),
            (x + lean, y - tall),
        ],
        50,
    )
    _brush_line(rng, ink, trunk, np.linspace(0.055, 0.012, 50) * tall, 0.95)
    for k in range(9):
        at = trunk[int(18 + 31 * k / 8)]
        way = (-1) ** k * (1.0 - 0.07 * k)
        reach = tall * rng.uniform(0.26, 0.46) * (1.1 - 0.08 * k)
        bough = curve(
            [
                tuple(at),
                (at[0] + 0.5 * way * reach, at[1] - 0.03 * tall),
                (at[0] + way * reach, at[1] + rng.uniform(-0.05, 0.07) * tall),
            ],
            24,
        )
        _brush_line(rng, ink, bough, np.linspace(0.02, 0.007, 24) * tall, 0.9)
        for spot in bough[7::3]:
            for _ in range(2):
                foot = spot + rng.normal(0, 0.018, 2) * tall
                for turn in np.linspace(-2.75, -0.4, 15):
                    length = tall * rng.uniform(0.035, 0.065)
                    tip = foot + length * np.array([np.cos(turn), 0.75 * np.sin(turn)])
                    ends = (foot * H).astype(int).tolist(), (tip * H).astype(int).tolist()
                    cv2.line(ink, ends[0], ends[1], float(rng.uniform(0.55, 0.95)), 2)


def _boat(rng: np.random.Generator, ink: Picture, x: float, y: float, size: float) -> None:
    """A fishing boat with a man and his pole, in four strokes."""
    hull = curve(
        [(x - size, y - 0.1 * size), (x, y + 0.12 * size), (x + size, y - 0.16 * size)], 30
    )
    _brush_line(rng, ink, hull, size * 0.16 * np.sin(np.linspace(0.3, 2.9, 30)), 0.95)
    roof = curve(
        [(x - 0.1 * size, y), (x + 0.15 * size, y - 0.3 * size), (x + 0.5 * size, y - 0.05 * size)],
        16,
    )
    _brush_line(rng, ink, roof, np.full(16, 0.06 * size), 0.8)
    man = curve(
        [
            (x - 0.55 * size, y),
            (x - 0.52 * size, y - 0.3 * size),
            (x - 0.5 * size, y - 0.42 * size),
        ],
        10,
    )
    _brush_line(rng, ink, man, np.linspace(0.13, 0.1, 10) * size, 0.9)
    pole = np.array([[x - 0.5 * size, y - 0.3 * size], [x - 1.25 * size, y + 0.25 * size]])
    fine = np.linspace(pole[0], pole[1], 8)
    _brush_line(rng, ink, fine, np.full(8, 0.02 * size), 0.8)


def ink_wash() -> NDArray[np.uint8]:
    """A misty mountain lake in black ink on paper, with a red seal."""
    rng = np.random.default_rng(52)
    x, y = coordinates()
    ink = np.zeros((H, W), np.float32)
    wet = rolling(rng, 1.5, 3)
    fibre = spectral(rng, (H, W), 0.7)
    layers = [
        (0.46, 0.26, 5, 0.22, 0.16),
        (0.56, 0.30, 5, 0.36, 0.15),
        (0.68, 0.40, 4, 0.62, 0.15),
        (0.80, 0.16, 4, 0.5, 0.08),
    ]
    for level, height, peaks, strength, fade in layers:
        line = _ridge(rng, level, height, peaks)[None].astype(np.float32)
        depth = y + 0.006 * wet - line
        body = np.exp(-np.clip(depth, 0, None) / fade) * (depth > 0)
        edge = np.exp(-np.clip(depth, 0, None) / 0.008) * (depth > 0)  # ink gathers at a wet rim
        cracks = np.clip(np.sin((x * 46 + y * 30) + 5 * rolling(rng, 1.2, 4)), 0, 1) ** 4
        wash = strength * (body * (0.72 + 0.22 * wet + 0.45 * cracks * body) + 0.4 * edge)
        mist = np.exp(-(((y - level - 0.02) / 0.06) ** 2)) * 0.75
        ink = np.where(depth > 0, np.maximum(wash, 0), ink * (1 - 0.9 * mist))
    lake = y > 0.80
    ripples = np.clip(np.sin(y * 260 + 3 * rolling(rng, 1.3, 2)) - 0.72, 0, 1) * np.clip(
        rolling(rng, 1.6, 2), 0, 1
    )
    ink = np.where(lake, ink * np.exp(-(y - 0.80) / 0.05) + 0.5 * ripples, ink).astype(np.float32)
    ink = np.asarray(cv2.GaussianBlur(ink, (0, 0), 1.5), np.float32)
    bank = curve([(-0.1, 0.84), (0.18, 0.82), (0.36, 0.90), (0.52, 1.1)], 60)
    shore = np.zeros((H, W), np.float32)
    cv2.fillPoly(shore, [(np.concatenate([bank, [[-0.1, 1.2]]]) * H).astype(np.int32)], 1.0)
    rock = shore * np.clip(0.62 + 0.35 * wet + 0.2 * np.sin(x * 60 + y * 90 + 4 * wet), 0.1, 0.95)
    ink = np.where(shore > 0, rock, ink).astype(np.float32)
    for root, tall in (((0.12, 0.86), 0.62), ((0.27, 0.88), 0.40)):
        _pine(rng, ink, root, tall)
    _boat(rng, ink, 0.86, 0.885, 0.085)
    for k in range(7):
        bx, by = (
            0.80 + 0.045 * k + rng.normal(0, 0.006),
            0.15 + 0.018 * abs(k - 2) + rng.normal(0, 0.006),
        )
        wing = curve([(bx - 0.016, by - 0.008), (bx, by), (bx + 0.016, by - 0.010)], 10)
        _brush_line(rng, ink, wing, 0.006 * np.sin(np.linspace(0.2, 2.9, 10)), 0.85)
    ink = np.clip(ink * (1 + 0.10 * fibre) + 0.012 * fibre * (ink > 0.03), 0, 1)[..., None]
    paper = PAPER * (1 + 0.018 * fibre[..., None] + 0.012 * rolling(rng, 1.2)[..., None])
    picture = paper * (1 - ink) + SOOT * ink
    _seal(picture)
    fine = cv2.resize(np.clip(picture, 0, 1), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    return (fine * 255).astype(np.uint8)


def _seal(picture: NDArray[np.float64]) -> None:
    """A vermilion seal with carved strokes."""
    red, size = (0.76, 0.18, 0.12), 0.075
    x, y = 1.135, 0.10
    corner = np.array([x, y]) * H
    cv2.rectangle(
        picture, corner.astype(int).tolist(), (corner + size * H).astype(int).tolist(), red, -1
    )
    strokes = [
        (0.15, 0.2, 0.85, 0.2),
        (0.5, 0.2, 0.5, 0.8),
        (0.2, 0.5, 0.8, 0.5),
        (0.2, 0.5, 0.2, 0.85),
        (0.8, 0.5, 0.8, 0.85),
        (0.2, 0.85, 0.8, 0.85),
    ]
    for a, b, c, d in strokes:
        start, end = corner + np.array([a, b]) * size * H, corner + np.array([c, d]) * size * H
        cv2.line(picture, start.astype(int).tolist(), end.astype(int).tolist(), PAPER.tolist(), 5)
