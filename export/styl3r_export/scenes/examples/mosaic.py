"""A Roman mosaic: tesserae in rows that follow two fish, their waves and a border."""

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.examples.brush import Picture
from styl3r_export.scenes.examples.oils import ASPECT, HEIGHT, WIDTH, H, W, coordinates
from styl3r_export.scenes.examples.still_life import curve
from styl3r_export.scenes.noise import spectral

#: Side of a tessera and of its pitch, canvas pixels.
TESSERA, PITCH = 13.0, 16.0
MORTAR = (0.52, 0.48, 0.43)


def _fish(
    image: Picture, regions: NDArray, at: tuple, size: float, turn: float, tones: list
) -> None:
    """A fish with fins, bands, a gill and an eye; every patch is a region of its own."""
    c, s = np.cos(turn), np.sin(turn)

    def patch(points: list, colour: tuple) -> None:
        p = np.array(points) * size
        world = np.stack([c * p[:, 0] - s * p[:, 1] + at[0], s * p[:, 0] + c * p[:, 1] + at[1]], 1)
        corners = [(world * H).astype(np.int32)]
        cv2.fillPoly(image, corners, colour)
        cv2.fillPoly(regions, corners, int(regions.max()) + 1)

    top = curve([(-1.0, 0.0), (-0.5, -0.36), (0.1, -0.42), (0.7, -0.16), (1.0, 0.0)], 30)
    low = curve([(1.0, 0.0), (0.7, 0.15), (0.1, 0.36), (-0.5, 0.32), (-1.0, 0.0)], 30)
    patch([(0.9, 0.0), (1.45, -0.42), (1.3, 0.0), (1.45, 0.42)], tones[1])
    patch([(-0.25, -0.38), (0.15, -0.72), (0.62, -0.5), (0.55, -0.2)], tones[1])
    patch([(-0.1, 0.3), (0.15, 0.62), (0.45, 0.25)], tones[1])
    patch([*map(tuple, top), *map(tuple, low)], tones[0])
    patch([*map(tuple, low), (-0.6, 0.08), (0.2, 0.1)], tones[2])
    for x in (-0.1, 0.22, 0.52):
        h = 0.36 * np.cos(x * 1.3)
        patch(
            [
                (x, -h),
                (x + 0.13, -h + 0.03),
                (x + 0.19, 0),
                (x + 0.13, h * 0.7),
                (x, h * 0.7),
                (x + 0.06, 0),
            ],
            tones[3],
        )
    patch(
        [(-1.0, 0.0), (-0.7, -0.25), (-0.42, -0.36), (-0.36, 0.0), (-0.45, 0.3), (-0.72, 0.2)],
        tones[4],
    )
    eye = [(-0.66 + 0.1 * np.cos(a), -0.08 + 0.1 * np.sin(a)) for a in np.arange(12) * np.pi / 6]
    patch(eye, (0.97, 0.95, 0.88))
    pupil = [
        (-0.67 + 0.05 * np.cos(a), -0.08 + 0.05 * np.sin(a)) for a in np.arange(10) * np.pi / 5
    ]
    patch(pupil, (0.08, 0.07, 0.08))


def _design() -> tuple[Picture, NDArray]:
    """Colours and region numbers: sea bands, a sun, two fish, a border of waves."""
    x, y = coordinates()
    image = np.empty((H, W, 3), np.float32)
    regions = np.zeros((H, W), np.int32)
    seas = [
        (0.82, 0.86, 0.80),
        (0.50, 0.72, 0.74),
        (0.24, 0.52, 0.62),
        (0.12, 0.34, 0.50),
        (0.08, 0.22, 0.38),
    ]
    for k, tone in enumerate(seas):
        below = y > -0.05 + 0.21 * k + 0.035 * np.sin(7 * x + 1.9 * k) + 0.02 * np.sin(13 * x + k)
        image[below], regions[below] = tone, k + 1
    image[regions == 0] = seas[0]
    radius = np.hypot(x - 1.0, y - 0.22)
    angle = np.arctan2(y - 0.22, x - 1.0)
    rays = radius < 0.15 + 0.035 * np.sign(np.sin(angle * 12))
    image[rays], regions[rays] = (0.93, 0.66, 0.20), 20
    image[radius < 0.10], regions[radius < 0.10] = (0.98, 0.84, 0.42), 21
    red = [
        (0.85, 0.38, 0.18),
        (0.72, 0.20, 0.14),
        (0.95, 0.72, 0.42),
        (0.98, 0.88, 0.66),
        (0.68, 0.25, 0.14),
    ]
    gold = [
        (0.87, 0.68, 0.25),
        (0.62, 0.38, 0.14),
        (0.97, 0.88, 0.58),
        (0.45, 0.30, 0.16),
        (0.75, 0.50, 0.18),
    ]
    _fish(image, regions, (0.50, 0.42), 0.26, 0.16, red)
    _fish(image, regions, (0.80, 0.73), 0.21, np.pi - 0.12, gold)
    edge = np.minimum(np.minimum(x, ASPECT - x), np.minimum(y, 1 - y))
    for k, (limit, tone) in enumerate(
        [(0.075, (0.90, 0.84, 0.70)), (0.056, (0.55, 0.18, 0.14)), (0.022, (0.90, 0.84, 0.70))]
    ):
        image[edge < limit], regions[edge < limit] = tone, 90 + k
    return image, regions


def roman() -> NDArray[np.uint8]:
    """Two fish and a sun in tesserae of stone, glass and gold."""
    rng = np.random.default_rng(14)
    image, regions = _design()
    borders = np.zeros((H, W), np.uint8)
    borders[:, 1:] |= (regions[:, 1:] != regions[:, :-1]).astype(np.uint8)
    borders[1:] |= (regions[1:] != regions[:-1]).astype(np.uint8)
    distance = cv2.distanceTransform(1 - borders, cv2.DIST_L2, 5)
    smooth = cv2.GaussianBlur(distance, (0, 0), 3)
    canvas = np.empty((H, W, 3), np.float32)
    canvas[:] = MORTAR
    canvas *= (1 + 0.08 * spectral(rng, (H, W), 0.5))[..., None]
    taken = np.zeros((H, W), np.uint8)
    gx, gy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    for level in range(int(distance.max() / PITCH) + 1):
        edge = (distance > (level + 0.5) * PITCH).astype(np.uint8)
        rows, _ = cv2.findContours(edge, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        for row in rows:
            _row(rng, canvas, taken, image, row[:, 0].astype(np.float64), (gx, gy))
    ys, xs = np.mgrid[0 : H : PITCH / 2, 0 : W : PITCH / 2]
    rest = rng.permutation(np.stack([xs.ravel(), ys.ravel()], 1))
    for p in rest:  # fill what the rows left
        _tessera(rng, canvas, taken, image, p, rng.uniform(0, np.pi), TESSERA * 0.8, 0.2)
    shine = spectral(rng, (H, W), 1.4)[..., None]
    picture = np.clip(canvas * (1 + 0.03 * shine), 0, 1)
    fine = cv2.resize(picture, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    return (fine * 255).astype(np.uint8)


def _row(
    rng: np.random.Generator,
    canvas: Picture,
    taken: NDArray,
    image: Picture,
    line: NDArray,
    slope: tuple,
) -> None:
    """Set stones along a contour at an even pitch."""
    steps = np.linalg.norm(np.diff(line, axis=0, append=line[:1]), axis=1)
    travelled = np.cumsum(steps)
    count = int(travelled[-1] / PITCH)
    for k in range(count):
        p = line[int(np.searchsorted(travelled, (k + 0.5) * travelled[-1] / count)) % len(line)]
        i, j = int(np.clip(p[1], 0, H - 1)), int(np.clip(p[0], 0, W - 1))
        angle = float(np.arctan2(slope[1][i, j], slope[0][i, j]))
        _tessera(rng, canvas, taken, image, p, angle + rng.normal(0, 0.06), TESSERA, 0.22)


def _tessera(
    rng: np.random.Generator,
    canvas: Picture,
    taken: NDArray,
    image: Picture,
    p: NDArray,
    angle: float,
    side: float,
    overlap: float,
) -> None:
    """One stone: a shade of its region's colour, a lit and a dark edge, unless there is no room."""
    size = side * rng.uniform(0.88, 1.08, 2)
    corners = cv2.boxPoints((p.tolist(), size.tolist(), float(np.degrees(angle))))
    x0, y0 = np.maximum(np.floor(corners.min(0)).astype(int) - 1, 0)
    x1, y1 = np.ceil(corners.max(0)).astype(int) + 2
    window = taken[y0:y1, x0:x1]
    if window.size == 0:
        return
    mask = np.zeros_like(window)
    local = np.round((corners - [x0, y0]) * 8).astype(np.int32)
    cv2.fillPoly(mask, [local], 1, cv2.LINE_8, 3)
    if mask.sum() == 0 or (window & mask).sum() > overlap * mask.sum():
        return
    mask &= 1 - window
    window |= mask
    i, j = int(np.clip(p[1], 0, H - 1)), int(np.clip(p[0], 0, W - 1))
    tone = image[i, j] * np.exp(rng.normal(0, 0.13)) + rng.normal(0, 0.03, 3)
    if rng.random() < 0.05:
        tone = tone * 0.4 + np.array([0.95, 0.80, 0.40]) * 0.6  # gold glass
    ys, xs = np.mgrid[y0 : y0 + window.shape[0], x0 : x0 + window.shape[1]]
    tilt = rng.normal(0, 0.012, 2)
    light = 1 - 0.018 * ((xs - p[0]) + (ys - p[1])) + tilt[0] * (xs - p[0]) + tilt[1] * (ys - p[1])
    stone = np.clip(tone, 0, 1) * light[..., None]
    target = canvas[y0:y1, x0:x1]
    np.copyto(target, stone.astype(np.float32), where=(mask > 0)[..., None])
