"""Procedural pictures for surfaces: bricks, planks, stripes, stone, print, book spines."""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.noise import spectral

#: Hues by their sixth of the colour wheel (0 red, 2 green, 4 blue) with spreads: warm, foliage,
#: blue, any; and how often each is met among things people photograph.
HUES = [(0.6, 0.3), (1.4, 0.4), (3.6, 0.4), (0.0, 6.0)]
HUE_ODDS = [0.48, 0.15, 0.19, 0.18]
#: Side of a texture picture in pixels.
SIDE = 256
Picture = NDArray[np.floating]


def colour(rng: np.random.Generator, vivid: float | None = None) -> NDArray[np.float32]:
    """A random sRGB colour; most are muted, as things in rooms and streets are."""
    vivid = float(rng.beta(1.1, 2.8)) if vivid is None else vivid
    value = rng.uniform(0.12, 0.95)
    # Sixths of the colour wheel: wood, skin and stone are orange, skies blue, plants green.
    centre, width = HUES[int(rng.choice(len(HUES), p=HUE_ODDS))]
    hue = rng.normal(centre, width) % 6
    wheel = np.clip(np.abs((hue + np.array([0.0, 4.0, 2.0])) % 6 - 3) - 1, 0, 1)
    return (value * (1 - vivid + vivid * wheel)).astype(np.float32)


def _flat(tint: NDArray[np.float32]) -> Picture:
    return np.broadcast_to(tint, (SIDE, SIDE, 3)).astype(np.float32).copy()


def _grain(rng: np.random.Generator, picture: Picture, amount: float) -> Picture:
    """Uneven brightness, as on anything real."""
    field = spectral(rng, (SIDE, SIDE), slope=rng.uniform(0.5, 1.5))
    return picture * (1 + amount * field[..., None])


def clouds(rng: np.random.Generator) -> Picture:
    """Noise through a ramp of a few colours: stone, rust, plaster, moss."""
    field = spectral(rng, (SIDE, SIDE), slope=rng.uniform(0.8, 1.8), lowest=rng.uniform(1, 5))
    if rng.random() < 0.4:  # veins
        field = (1.5 - 3 * np.abs(field)).astype(np.float32)
    stops = np.sort(rng.uniform(-1.8, 1.8, 4))
    base = colour(rng)
    ramp = np.array([0.6 * base + 0.4 * colour(rng) for _ in stops])
    return np.stack([np.interp(field, stops, ramp[:, k]) for k in range(3)], -1).astype(np.float32)


def bricks(rng: np.random.Generator) -> Picture:
    """Courses of bricks, tiles or paving, each its own shade."""
    rows = int(rng.choice([4, 6, 8, 12, 16]))
    columns = max(1, int(rows / rng.choice([1.0, 2.0, 2.5, 4.0])))
    offset = float(rng.choice([0.0, 0.5, 0.5, 0.33]))
    tint, mortar = colour(rng), colour(rng, 0.1)
    y, x = np.mgrid[0:SIDE, 0:SIDE] / SIDE
    row = np.floor(y * rows)
    across = x * columns + offset * row
    column = np.floor(across) % columns
    shade = rng.normal(0, rng.uniform(0.02, 0.18), (rows, columns, 1)).astype(np.float32)
    hue = rng.normal(0, 0.04, (rows, columns, 3)).astype(np.float32)
    picture = tint * (1 + (shade + hue)[row.astype(int), column.astype(int)])
    joint = rng.uniform(0.02, 0.09)
    edge = np.minimum(y * rows % 1, 1 - y * rows % 1), np.minimum(across % 1, 1 - across % 1)
    gap = (edge[0] < joint) | (edge[1] * rows / columns < joint)
    picture = np.where(gap[..., None], mortar, picture)
    return _grain(rng, picture.astype(np.float32), rng.uniform(0.02, 0.15))


def planks(rng: np.random.Generator) -> Picture:
    """Boards with grain running along them."""
    count = int(rng.integers(1, 9))
    tint = np.array([0.62, 0.43, 0.26], np.float32) * rng.uniform(0.35, 1.45)
    tint = 0.75 * tint + 0.25 * colour(rng)
    grain = spectral(rng, (SIDE, SIDE // 16), slope=0.7)
    grain = np.asarray(cv2.resize(grain, (SIDE, SIDE), interpolation=cv2.INTER_CUBIC), np.float32)
    waves = spectral(rng, (SIDE, SIDE), slope=2.0)
    y = np.mgrid[0:SIDE, 0:SIDE][0] / SIDE
    rings = np.sin(2 * np.pi * (rng.uniform(6, 30) * y + rng.uniform(0.3, 1.5) * waves))
    board = np.floor(y * count).astype(int)
    shade = rng.normal(0, 0.12, count)[board]
    picture = tint * (1 + 0.10 * grain + 0.07 * rings + shade)[..., None]
    if count > 1:
        picture = np.where(((y * count) % 1 < 0.03)[..., None], 0.35 * picture, picture)
    picture = picture.astype(np.float32)
    return np.ascontiguousarray(picture.transpose(1, 0, 2)) if rng.random() < 0.5 else picture


def stripes(rng: np.random.Generator) -> Picture:
    """Stripes, checks or plaid of a few colours."""
    bands = [colour(rng) for _ in range(int(rng.integers(2, 5)))]
    count = int(rng.choice([2, 3, 4, 6, 8, 12])) * len(bands)
    t = np.arange(SIDE) * count // SIDE
    line = np.array([bands[k % len(bands)] for k in t], np.float32)
    kind = rng.random()
    if kind < 0.45:
        picture = np.broadcast_to(line[None], (SIDE, SIDE, 3)).copy()
    elif kind < 0.75:
        picture = ((line[None] + line[:, None]) / 2).astype(np.float32)
    else:
        checks = (t[:, None] + t[None]) % len(bands)
        picture = np.array(bands)[checks]
    return _grain(rng, picture.astype(np.float32), rng.uniform(0.0, 0.08))


def spots(rng: np.random.Generator) -> Picture:
    """A motif repeated on a cloth or wallpaper, regular or strewn."""
    picture = _flat(colour(rng))
    count = int(rng.integers(3, 9))
    strewn, radius = rng.random() < 0.4, SIDE / count * rng.uniform(0.15, 0.45)
    inks = [colour(rng).tolist() for _ in range(3)]
    corners = int(rng.integers(3, 9))
    for i in range(count):
        for j in range(count):
            centre = (np.array([j, i]) + 0.5 + 0.5 * (i % 2) * np.array([1, 0])) * SIDE / count
            if strewn:
                centre = rng.uniform(0, SIDE, 2)
            turn = rng.uniform(0, 6.3) if strewn else 0.0
            angle = turn + np.arange(corners * 2) * np.pi / corners
            reach = radius * np.where(np.arange(corners * 2) % 2, 0.45, 1.0)
            star = centre + reach[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
            cv2.fillPoly(picture, [star.astype(np.int32)], inks[(i + j) % 3], cv2.LINE_AA)
            cv2.circle(
                picture, tuple(int(v) for v in centre), int(radius * 0.35), inks[(i * j) % 3], -1
            )
    return _grain(rng, picture, 0.05)


def print_page(rng: np.random.Generator) -> Picture:
    """A printed page or label: lines of word-like marks, a heading, a picture block."""
    paper, ink = colour(rng, 0.1) * 0.3 + 0.65, colour(rng, 0.5) * 0.35
    if rng.random() < 0.25:
        paper, ink = ink, paper
    picture = _flat(paper.astype(np.float32))
    y = int(rng.integers(8, 30))
    while y < SIDE - 14:
        heading = rng.random() < 0.15
        height = int(rng.integers(9, 22)) if heading else 4
        x = 14
        while x < SIDE - 24:
            word = int(rng.integers(6, 30)) * (2 if heading else 1)
            end = min(x + word, SIDE - 14)
            cv2.rectangle(picture, (x, y), (end, y + height), ink.tolist(), -1)
            for stroke in range(x, end, 4 if not heading else 9):
                cv2.line(picture, (stroke, y), (stroke, y + height), paper.tolist(), 1)
            x = end + 6
        if rng.random() < 0.12:
            block = (clouds(rng) if rng.random() < 0.5 else collage(rng))[:60, : SIDE - 60]
            bottom = min(y + 20 + 60, SIDE)
            picture[y + 20 : bottom, 30 : SIDE - 30] = block[: max(bottom - y - 20, 0)]
            y = bottom
        y += height + int(rng.integers(5, 10))
    return picture


def spines(rng: np.random.Generator) -> Picture:
    """A row of book spines with titles."""
    picture = _flat(np.full(3, 0.05, np.float32))
    x = 0
    while x < SIDE:
        width, top = int(rng.integers(9, 34)), int(rng.integers(0, 60))
        tint, ink = colour(rng), colour(rng)
        cv2.rectangle(picture, (x, top), (x + width - 2, SIDE), tint.tolist(), -1)
        for band in rng.integers(top, SIDE, int(rng.integers(1, 5))):
            thick = int(rng.integers(1, 12))
            cv2.rectangle(
                picture, (x, int(band)), (x + width - 2, int(band) + thick), ink.tolist(), -1
            )
        x += width
    return picture


def collage(rng: np.random.Generator) -> Picture:
    """A poster or painting: overlapping shapes on a gradient."""
    t = np.linspace(0, 1, SIDE, dtype=np.float32)[:, None, None]
    picture = np.ascontiguousarray(
        np.broadcast_to(colour(rng) * (1 - t) + colour(rng) * t, (SIDE, SIDE, 3)), np.float32
    )
    for _ in range(int(rng.integers(4, 40))):
        centre = tuple(int(v) for v in rng.integers(0, SIDE, 2))
        size = rng.uniform(0.02, 0.3, 2) * SIDE
        tint, turn = colour(rng).tolist(), float(rng.uniform(0, 180))
        if rng.random() < 0.5:
            axes = tuple(int(v) + 1 for v in size)
            cv2.ellipse(picture, centre, axes, turn, 0, 360, tint, -1, cv2.LINE_AA)
        else:
            corners = cv2.boxPoints((centre, tuple(size), turn)).astype(np.int32)
            cv2.fillPoly(picture, [corners], tint, cv2.LINE_AA)
    return _grain(rng, picture, rng.uniform(0, 0.12))


def thicket(rng: np.random.Generator) -> Picture:
    """Many short strokes: grass, straw, fur, foliage seen from afar."""
    base = colour(rng)
    picture = _flat(base * 0.35)
    lean, spread = rng.uniform(0, np.pi), rng.uniform(0.1, 1.5)
    length = rng.uniform(6, 40)
    for _ in range(900):
        start = rng.uniform(-20, SIDE + 20, 2)
        angle = lean + rng.normal(0, spread)
        end = start + length * np.array([np.cos(angle), np.sin(angle)])
        tint = np.clip(base * rng.uniform(0.4, 1.5) + rng.normal(0, 0.05, 3), 0, 1).tolist()
        points = tuple(int(v) for v in start), tuple(int(v) for v in end)
        cv2.line(picture, *points, tint, int(rng.integers(1, 4)), cv2.LINE_AA)
    return picture


#: Every pattern, by how often it is drawn.
PATTERNS: list[tuple[Callable[[np.random.Generator], Picture], float]] = [
    (clouds, 4), (bricks, 3), (planks, 3), (stripes, 1.5), (spots, 1.5),
    (print_page, 1), (spines, 1), (collage, 2), (thicket, 2),
]  # fmt: skip


def draw_pattern(rng: np.random.Generator) -> NDArray[np.uint8]:
    """A random pattern as (256, 256, 3) uint8 sRGB."""
    weights = np.array([w for _, w in PATTERNS])
    kind = rng.choice(len(PATTERNS), p=weights / weights.sum())
    picture = PATTERNS[int(kind)][0](rng)
    return (np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8)
