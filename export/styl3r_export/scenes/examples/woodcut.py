"""A woodblock print: a great wave with foam claws before a far mountain."""

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.examples.brush import Picture
from styl3r_export.scenes.examples.oils import ASPECT, HEIGHT, WIDTH, H, W, coordinates
from styl3r_export.scenes.examples.still_life import curve
from styl3r_export.scenes.noise import spectral

#: Inks: outline, deep, middle and light blue, foam and paper.
INK, DEEP = (0.07, 0.12, 0.24), (0.11, 0.24, 0.44)
MIDDLE, LIGHT = (0.28, 0.49, 0.63), (0.62, 0.76, 0.78)
FOAM, PAPER = (0.97, 0.94, 0.85), (0.90, 0.83, 0.67)

Points = NDArray[np.float64]


def _fill(image: Picture, points: Points, colour: tuple, edge: int = 5) -> None:
    corners = [np.round(points * H * 16).astype(np.int32)]
    cv2.fillPoly(image, corners, colour, cv2.LINE_8, 4)
    if edge:
        cv2.polylines(image, corners, True, INK, edge, cv2.LINE_8, 4)


def _line(image: Picture, points: Points, colour: tuple, thick: int) -> None:
    cv2.polylines(
        image, [np.round(points * H * 16).astype(np.int32)], False, colour, thick, cv2.LINE_8, 4
    )


def _carved(image: Picture, outer: Points, inner: Points, count: int) -> None:
    """Bands between two edges of a wave, from its back to its hollow."""
    inks = [DEEP, MIDDLE, DEEP, LIGHT]
    for k in range(count):
        a, b = k / count, (k + 0.62) / count
        band = np.concatenate([outer + (inner - outer) * a, (outer + (inner - outer) * b)[::-1]])
        _fill(image, band, inks[k % len(inks)], 3)


def _claws(
    rng: np.random.Generator, image: Picture, crest: Points, size: float, sign: float
) -> None:
    """Foam along a crest: lobes that end in hooked fingers, and spray beyond them."""
    ahead = np.gradient(crest, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    out = sign * np.stack([-ahead[:, 1], ahead[:, 0]], 1)
    for p, d, n in zip(crest, ahead, out, strict=True):
        for _ in range(2):
            reach = size * rng.uniform(0.7, 1.5)
            turn = rng.normal(0.5, 0.45)
            way = np.cos(turn) * n + np.sin(turn) * d
            side = np.array([-way[1], way[0]])
            root = p + rng.normal(0, 0.25, 2) * size
            # Along and across the finger: its back, its hooked tip, its hollow side.
            outline = [(0, -0.28), (0.6, -0.2), (1, 0.22), (0.72, 0.08), (0.45, 0.22), (0, 0.30)]
            hook = curve([tuple(root + (a * way + b * side) * reach) for a, b in outline], 26)
            _fill(image, hook, FOAM, 3)
    for p, n in zip(crest, out, strict=True):
        for _ in range(3):
            q = p + n * size * rng.uniform(0.9, 3.2) + rng.normal(0, 0.7, 2) * size
            r = int(H * size * rng.uniform(0.05, 0.16))
            at = (int(q[0] * H), int(q[1] * H))
            cv2.circle(image, at, r + 2, INK, -1)
            cv2.circle(image, at, r, FOAM, -1)
    for p, n in zip(crest, out, strict=True):
        for _ in range(2):
            q = p - n * size * rng.uniform(0.0, 0.7) + rng.normal(0, 0.2, 2) * size
            cv2.circle(
                image,
                (int(q[0] * H), int(q[1] * H)),
                int(H * size * rng.uniform(0.16, 0.34)),
                FOAM,
                -1,
            )


def _swell(rng: np.random.Generator, image: Picture, knots: list, drop: float, count: int) -> None:
    """A lower wave: bands that follow its back, foam on the crest."""
    top = curve(knots, 60)
    _fill(image, np.concatenate([top, [[ASPECT + 0.1, 1.2], [-0.1, 1.2]]]), DEEP)
    under = top + np.array([0.05, drop])
    _carved(image, top + np.array([0, 0.012]), under, count)
    peak = int(np.argmin(top[:, 1]))
    crest = top[max(peak - 9, 0) : peak + 10]
    _claws(rng, image, crest[:: 2 if len(crest) > 10 else 1], 0.035, -1.0)


def great_wave() -> NDArray[np.uint8]:
    """Bold waves in three blues on warm paper."""
    rng = np.random.default_rng(6)
    x, y = coordinates()
    fade = np.clip(1.1 - y * 1.9, 0, 1)[..., None] ** 1.5
    image = np.ascontiguousarray(
        PAPER * (1 - 0.55 * fade) + 0.55 * fade * np.array([0.40, 0.44, 0.50]), np.float32
    )
    haze = ((np.sin(4 * x + 1) * 0.03 + 0.42 - y) > 0) & (y > 0.34)
    image[haze] = image[haze] * 0.5 + np.array([0.97, 0.86, 0.68], np.float32) * 0.5
    cv2.circle(image, (int(0.93 * H), int(0.20 * H)), int(0.085 * H), (0.80, 0.27, 0.17), -1)
    mountain = curve(
        [(0.40, 0.80), (0.66, 0.625), (0.78, 0.485), (0.83, 0.485), (0.94, 0.62), (1.16, 0.78)], 40
    )
    _fill(image, mountain, (0.30, 0.38, 0.50), 4)
    cap = np.array(
        [
            [0.742, 0.535],
            [0.78, 0.487],
            [0.83, 0.487],
            [0.866, 0.53],
            [0.845, 0.525],
            [0.825, 0.56],
            [0.803, 0.525],
            [0.775, 0.555],
        ]
    )
    _fill(image, cap, FOAM, 0)
    _swell(
        rng, image, [(-0.1, 0.72), (0.3, 0.70), (0.62, 0.76), (0.98, 0.60), (1.35, 0.70)], 0.20, 8
    )
    back = curve(
        [(-0.12, 0.98), (-0.02, 0.55), (0.16, 0.20), (0.38, 0.075), (0.58, 0.13), (0.665, 0.27)], 70
    )
    hollow = curve(
        [(0.36, 1.05), (0.33, 0.72), (0.36, 0.46), (0.46, 0.32), (0.56, 0.29), (0.665, 0.30)], 70
    )
    _fill(image, np.concatenate([back, hollow[::-1]]), DEEP, 7)
    _carved(image, back + (hollow - back) * 0.10, hollow, 9)
    rim = np.concatenate([back, (back + (hollow - back) * 0.16)[::-1]])
    _fill(image, rim[8:-8], FOAM, 3)
    _claws(rng, image, back[26::2], 0.046, -1.0)
    _claws(rng, image, hollow[44::3], 0.036, 1.0)
    _swell(
        rng,
        image,
        [(-0.1, 0.90), (0.22, 0.93), (0.55, 0.98), (0.86, 0.80), (1.02, 0.83), (1.35, 1.0)],
        0.22,
        9,
    )
    return _printed(rng, image)


def _printed(rng: np.random.Generator, image: Picture) -> NDArray[np.uint8]:
    """Wood grain in the colour, uneven ink, fibres in the paper."""
    grain = cv2.resize(spectral(rng, (H, 24), 0.9), (W, H), interpolation=cv2.INTER_CUBIC)
    y = np.mgrid[0:H, 0:W][0] / H
    warp = cv2.resize(spectral(rng, (64, 64), 2.0), (W, H), interpolation=cv2.INTER_CUBIC)
    rings = np.sin(2 * np.pi * (26 * y + 0.9 * warp))
    patchy = cv2.resize(spectral(rng, (128, 128), 1.0), (W, H), interpolation=cv2.INTER_CUBIC)
    dark = 1 - image.mean(-1)
    ink = 1 + (0.035 * grain + 0.045 * rings + 0.035 * patchy) * (0.35 + dark)
    speck = (spectral(rng, (H, W), 0.6) > 2.1) * dark * 0.5
    out = image * ink[..., None] + speck[..., None] * (np.asarray(PAPER) - image)
    fine = cv2.resize(
        np.clip(out, 0, 1).astype(np.float32), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA
    )
    return (fine * 255).astype(np.uint8)
