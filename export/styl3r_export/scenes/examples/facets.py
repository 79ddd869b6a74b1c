"""A cubist table: the motif broken into facets, each seen a little differently."""

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.examples.brush import Canvas, Layer, Picture, paint
from styl3r_export.scenes.examples.oils import ASPECT, H, W, coordinates, rolling

#: The palette that every colour is drawn to: umbers, ochres, greys, cream, a cold blue-green.
PALETTE = np.array(
    [[0.10, 0.08, 0.08], [0.30, 0.20, 0.13], [0.52, 0.36, 0.18], [0.78, 0.58, 0.28],
     [0.92, 0.83, 0.64], [0.42, 0.45, 0.46], [0.20, 0.30, 0.36], [0.62, 0.68, 0.66],
     [0.62, 0.25, 0.16]]
)  # fmt: skip


def _polygon(image: Picture, points: list[tuple[float, float]], colour: tuple) -> None:
    cv2.fillPoly(image, [(np.array(points) * H).astype(np.int32)], colour, cv2.LINE_AA)


def _motif() -> Picture:
    """Guitar, bottle, glass, sheet of music and lemon on a round table, in flat colours."""
    x, y = coordinates()
    warm = (0.5 + 0.5 * np.sin(2.6 * x - 3 * y + 1))[..., None]
    image = warm * np.array([0.80, 0.66, 0.44]) + (1 - warm) * np.array([0.38, 0.46, 0.50])
    image = np.ascontiguousarray(image, np.float32)

    def oval(cx: float, cy: float, rx: float, ry: float, turn: float, colour: tuple) -> None:
        centre, axes = (int(cx * H), int(cy * H)), (int(rx * H), int(ry * H))
        cv2.ellipse(image, centre, axes, turn, 0, 360, colour, -1, cv2.LINE_AA)

    oval(0.62, 0.80, 0.60, 0.27, 0, (0.45, 0.30, 0.16))
    _polygon(image, [(0.72, 0.50), (1.12, 0.58), (1.04, 0.90), (0.66, 0.80)], (0.93, 0.87, 0.72))
    for k in range(6):
        a, b = np.array([0.745, 0.55 + 0.045 * k]), np.array([1.07, 0.615 + 0.045 * k])
        ends = (a * H).astype(int).tolist(), (b * H).astype(int).tolist()
        cv2.line(image, ends[0], ends[1], (0.12, 0.1, 0.1), 4)
    oval(0.40, 0.70, 0.215, 0.175, -35, (0.74, 0.48, 0.20))
    oval(0.545, 0.545, 0.150, 0.120, -35, (0.80, 0.55, 0.25))
    oval(0.470, 0.620, 0.060, 0.060, 0, (0.10, 0.07, 0.06))
    _polygon(image, [(0.60, 0.47), (0.64, 0.515), (0.98, 0.20), (0.94, 0.15)], (0.28, 0.16, 0.10))
    _polygon(image, [(0.92, 0.13), (0.99, 0.21), (1.06, 0.13), (0.99, 0.05)], (0.12, 0.09, 0.09))
    for k in range(4):
        a = np.array([0.33 + 0.012 * k, 0.735 + 0.014 * k])
        b = np.array([0.945 + 0.012 * k, 0.155 + 0.014 * k])
        ends = (a * H).astype(int).tolist(), (b * H).astype(int).tolist()
        cv2.line(image, ends[0], ends[1], (0.95, 0.88, 0.70), 3)
    green = (0.16, 0.28, 0.26)
    _polygon(image, [(0.14, 0.86), (0.30, 0.86), (0.30, 0.44), (0.25, 0.34), (0.25, 0.14),
                     (0.19, 0.14), (0.19, 0.34), (0.14, 0.44)], green)  # fmt: skip
    _polygon(image, [(0.15, 0.55), (0.29, 0.55), (0.29, 0.72), (0.15, 0.72)], (0.90, 0.82, 0.62))
    _polygon(image, [(0.86, 0.62), (1.02, 0.62), (0.98, 0.88), (0.90, 0.88)], (0.70, 0.78, 0.78))
    oval(0.94, 0.62, 0.08, 0.025, 0, (0.86, 0.90, 0.88))
    oval(0.70, 0.90, 0.07, 0.05, 20, (0.93, 0.76, 0.26))
    return image


def _split(rng: np.random.Generator, polygon: NDArray[np.float64], least: float) -> list:
    """Cut a convex polygon by slanted lines until its pieces are small."""
    shifted = np.roll(polygon, -1, 0)
    area = 0.5 * abs((polygon[:, 0] * shifted[:, 1] - polygon[:, 1] * shifted[:, 0]).sum())
    if area < least * rng.uniform(0.5, 3.0):
        return [polygon]
    spread = polygon - polygon.mean(0)
    main = np.linalg.eigh(spread.T @ spread)[1][:, 1]
    lean = rng.choice([0.0, 0.6, -0.6]) + rng.normal(0, 0.15)
    c, s = np.cos(lean), np.sin(lean)
    normal = np.array([c * main[0] - s * main[1], s * main[0] + c * main[1]])
    middle = polygon.mean(0) + rng.normal(0, 0.12, 2) * np.ptp(polygon, axis=0)
    side = (polygon - middle) @ normal
    halves: list[list] = [[], []]
    for k in range(len(polygon)):
        a, b = side[k], side[(k + 1) % len(polygon)]
        halves[int(a > 0)].append(polygon[k])
        if (a > 0) != (b > 0):
            cut = polygon[k] + a / (a - b) * (polygon[(k + 1) % len(polygon)] - polygon[k])
            halves[0].append(cut)
            halves[1].append(cut)
    if min(len(h) for h in halves) < 3:
        return [polygon]
    return [p for h in halves for p in _split(rng, np.array(h), least)]


def cubist() -> NDArray[np.uint8]:
    """A cubist still life in umber, ochre and grey."""
    rng = np.random.default_rng(23)
    motif = _motif()
    frame = np.array([[0, 0], [ASPECT, 0], [ASPECT, 1], [0, 1]], np.float64)
    facets = _split(rng, frame, 0.013)
    x, y = coordinates()
    sketch, field = np.zeros_like(motif), np.zeros((H, W, 2), np.float32)
    lines = np.zeros((H, W), np.float32)
    for facet in facets:
        mask = np.zeros((H, W), np.uint8)
        corners = [np.round(facet * H).astype(np.int32)]
        cv2.fillPoly(mask, corners, 1)
        inside = mask > 0
        centre, turn = facet.mean(0), rng.normal(0, 0.12)
        zoom, c, s = rng.uniform(0.8, 1.15), np.cos(turn), np.sin(turn)
        dx, dy = (x - centre[0])[inside] * zoom, (y - centre[1])[inside] * zoom
        shift = rng.normal(0, 0.014, 2)
        u = (centre[0] + c * dx - s * dy + shift[0]) * H
        v = (centre[1] + s * dx + c * dy + shift[1]) * H
        seen = motif[np.clip(v, 0, H - 1).astype(int), np.clip(u, 0, W - 1).astype(int)]
        way = rng.uniform(0, 2 * np.pi)
        ramp = np.cos(way) * dx + np.sin(way) * dy
        ramp = (ramp - ramp.mean()) / max(float(np.ptp(ramp)), 1e-6)
        light = (rng.normal(0, 0.12) + 1.05 * ramp)[:, None]
        sketch[inside] = np.clip(seen * (1 + light) + 0.12 * light, 0, 1)
        field[inside] = [np.cos(way + np.pi / 2), np.sin(way + np.pi / 2)]
        cv2.polylines(lines, corners, True, 1.0, int(rng.choice([2, 3, 4, 6])), cv2.LINE_AA)
    distance = np.linalg.norm(sketch[:, :, None] - PALETTE[None, None], axis=-1)
    share = np.exp(-14 * distance)
    drawn = (share @ PALETTE) / share.sum(-1, keepdims=True)
    sketch = (0.45 * sketch + 0.55 * drawn).astype(np.float32)
    canvas = Canvas(H, W, (0.35, 0.28, 0.2))
    layers = [Layer(22, 50, 15, 0.05), Layer(12, 34, 9, 0.05), Layer(8, 24, 7, 0.04, 0.06)]
    paint(canvas, sketch, field, layers, rng)
    edge = cv2.GaussianBlur(lines, (0, 0), 1.2) * (0.75 + 0.2 * rolling(rng, 1.0))
    ink = np.clip(edge, 0, 1)[..., None]
    canvas.colour = (canvas.colour * (1 - 0.85 * ink) + 18 * 0.85 * ink).astype(np.uint8)
    return canvas.finished(0.6)
