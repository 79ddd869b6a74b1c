"""Two oil paintings: a swirling night over a village, and poppies below a hot sky."""

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_export.scenes.examples.brush import FINER, Canvas, Layer, Picture, along, paint
from styl3r_export.scenes.noise import spectral

#: Final size of all example paintings.
WIDTH, HEIGHT = 560, 448
W, H = WIDTH * FINER, HEIGHT * FINER
#: Ratio of sides: sketches use x in 0..ASPECT and y in 0..1 (down).
ASPECT = W / H


def coordinates() -> tuple[Picture, Picture]:
    """X and y of every canvas pixel."""
    y, x = np.mgrid[0:H, 0:W].astype(np.float32)
    return (x + 0.5) / H, (y + 0.5) / H


def rolling(rng: np.random.Generator, slope: float, lowest: float = 2.0) -> Picture:
    """Smooth noise over the canvas."""
    field = spectral(rng, (128, 128), slope, lowest)
    return np.asarray(cv2.resize(field, (W, H), interpolation=cv2.INTER_CUBIC), np.float32)


def _mix(a: Picture, b: object, share: Picture) -> Picture:
    share = np.clip(share, 0, 1)[..., None]
    return (a * (1 - share) + np.asarray(b, np.float32) * share).astype(np.float32)


#: Centre, size, strength of the night sky's whirls.
WHIRLS = [(0.50, 0.30, 0.17, 1.0), (0.80, 0.43, 0.11, -0.9), (0.12, 0.16, 0.10, -0.7)]
#: Stars: place and size; the last is the moon.
STARS = [
    (0.27, 0.10, 0.030), (0.40, 0.53, 0.024), (0.66, 0.10, 0.034), (0.83, 0.20, 0.022),
    (0.93, 0.50, 0.026), (0.30, 0.34, 0.020), (0.99, 0.33, 0.018), (1.10, 0.15, 0.060),
]  # fmt: skip


def night() -> NDArray[np.uint8]:
    """Whirling night sky, moon and stars over hills, a village and a cypress."""
    rng = np.random.default_rng(41)
    x, y = coordinates()
    stream = 1.1 * y + 0.05 * rolling(rng, 2.4) + 0.03 * np.sin(7 * x + 2 * y)
    for cx, cy, size, strength in WHIRLS:
        r2 = ((x - cx) ** 2 + (y - cy) ** 2) / size**2
        stream += 4.6 * strength * size * np.exp(-r2 / 2.2)
    for cx, cy, size in STARS:
        r2 = ((x - cx) ** 2 + (y - cy) ** 2) / (2.2 * size) ** 2
        stream += 5.0 * size * np.exp(-r2)
    deep, light = np.array([0.05, 0.09, 0.33]), np.array([0.33, 0.55, 0.75])
    bands = 0.5 + 0.5 * np.sin(stream * 30 + 0.5 * rolling(rng, 1.6))
    sketch = _mix(np.broadcast_to(deep, (H, W, 3)), light, 0.12 + 0.62 * bands * (0.35 + 0.9 * y))
    sketch = _mix(sketch, [0.80, 0.86, 0.74], (bands > 0.9) * 0.55)
    sketch = _mix(sketch, [0.10, 0.16, 0.52], (bands < 0.12) * 0.7)
    for cx, cy, size in STARS:
        r = np.hypot(x - cx, y - cy) / size
        halo = 0.5 + 0.5 * np.cos(np.minimum(r, 3.2) * 4.2)
        sketch = _mix(
            sketch, [0.93, 0.86, 0.52], np.clip(1.25 - r / 3.0, 0, 1) * (0.45 + 0.4 * halo)
        )
        sketch = _mix(sketch, [1.0, 0.80, 0.25], (r < 0.9) * 1.0)
    cx, cy, size = STARS[-1]
    bite = np.hypot(x - cx + 0.55 * size, y - cy + 0.25 * size) / size
    sketch = _mix(sketch, [0.86, 0.80, 0.50], (bite < 0.75) * 0.9)
    field = along(np.gradient(stream, axis=1), np.gradient(stream, axis=0))
    sketch, field, village = _night_land(rng, sketch, field, x, y)
    canvas = Canvas(H, W, (0.07, 0.09, 0.22))
    layers = [Layer(30, 150, 22, 0.10), Layer(19, 120, 15, 0.12), Layer(12, 80, 12, 0.12, 0.10)]
    paint(canvas, sketch, field, layers, rng)
    paint(canvas, sketch, field, [Layer(8, 46, 10, 0.08, 0.16)], rng)
    fine = [Layer(8, 26, 6, 0.06), Layer(5, 14, 5, 0.05, 0.08)]
    paint(canvas, sketch, field, fine, rng, village)
    return canvas.finished(0.75)


def _night_land(
    rng: np.random.Generator, sketch: Picture, field: NDArray[np.float32], x: Picture, y: Picture
) -> tuple[Picture, NDArray[np.float32], NDArray[np.bool_]]:
    """Hills, village and cypress before the sky, and where the houses are."""
    field = field.copy()
    tones = [(0.20, 0.34, 0.52), (0.10, 0.22, 0.40), (0.08, 0.17, 0.22)]
    for k, tone in enumerate(tones):
        edge = 0.66 + 0.075 * k + 0.05 * np.sin(3.1 * x + 1.7 * k) + 0.02 * np.sin(9 * x + k)
        below = y > edge
        rows = 0.5 + 0.5 * np.sin((y - edge) * 110 + 3 * np.sin(5 * x))
        ground = np.asarray(tone) * (0.75 + 0.65 * rows[..., None])
        sketch = np.where(below[..., None], ground, sketch).astype(np.float32)
        tilt = 0.155 * np.cos(3.1 * x + 1.7 * k) + 0.18 * np.cos(9 * x + k)
        direction = np.stack([np.ones_like(tilt), tilt], -1)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        field = np.where(below[..., None], direction, field)
    bare = np.ascontiguousarray(sketch)
    image = bare.copy()
    for cy in np.sort(rng.uniform(0.79, 0.95, 24)):
        cx = rng.uniform(0.40, 1.22)
        w, h = rng.uniform(0.024, 0.042), rng.uniform(0.022, 0.038)
        wall = np.array([0.36, 0.46, 0.60]) * rng.uniform(0.7, 1.3)
        roof = np.array([0.33, 0.20, 0.24]) * rng.uniform(0.8, 1.4)
        box = np.array([[cx - w, cy - h], [cx + w, cy - h], [cx + w, cy + h], [cx - w, cy + h]]) * H
        top = np.array([[cx - 1.25 * w, cy - h], [cx + 1.25 * w, cy - h], [cx, cy - 2.3 * h]]) * H
        cv2.fillPoly(image, [box.astype(np.int32)], wall.tolist())
        cv2.fillPoly(image, [top.astype(np.int32)], roof.tolist())
        if rng.random() < 0.75:
            corner = (np.array([cx - 0.4 * w, cy - 0.3 * h]) * H).astype(int)
            end = (np.array([cx + 0.4 * w, cy + 0.5 * h]) * H).astype(int)
            cv2.rectangle(image, corner.tolist(), end.tolist(), (1.0, 0.82, 0.30), -1)
    spire = (
        np.array([[0.735, 0.90], [0.775, 0.90], [0.766, 0.74], [0.755, 0.62], [0.744, 0.74]]) * H
    )
    cv2.fillPoly(image, [spire.astype(np.int32)], (0.16, 0.24, 0.42))
    village = cv2.dilate(np.abs(image - bare).max(-1), np.ones((9, 9))) > 0.01
    sway = 0.16 + 0.018 * np.sin(y * 16) + 0.03 * (y - 0.5)
    half = np.clip((y - 0.13) * 0.14, 0, 1) * (1 + 0.25 * np.sin(y * 42 + 3 * np.sin(x * 40)))
    tree = (np.abs(x - sway) < half) | (np.abs(x - sway - 0.085) < np.clip((y - 0.45) * 0.11, 0, 1))
    flame = 0.5 + 0.5 * np.sin((x - sway) * 170 + 9 * np.sin(y * 14))
    dark = np.array([0.04, 0.08, 0.07]) + flame[..., None] * np.array([0.10, 0.15, 0.07])
    image = np.where(tree[..., None], dark, image).astype(np.float32)
    lean = 0.5 * np.sin(y * 22 + x * 25)
    upward = np.stack([lean, -np.ones_like(lean)], -1) / np.sqrt(1 + lean**2)[..., None]
    village &= ~tree
    return image, np.where(tree[..., None], upward, field).astype(np.float32), village


def poppies() -> NDArray[np.uint8]:
    """A field of poppies and wheat below a burning evening sky, laid on with a knife."""
    rng = np.random.default_rng(17)
    x, y = coordinates()
    clouds = rolling(rng, 1.7) + 0.8 * np.sin(9 * y + 2 * x)
    sketch = _mix(np.broadcast_to([0.98, 0.70, 0.22], (H, W, 3)), [0.92, 0.33, 0.16], 1.1 - 2.4 * y)
    sketch = _mix(sketch, [1.0, 0.86, 0.45], 0.4 * clouds)
    sketch = _mix(sketch, [0.62, 0.22, 0.36], -0.45 * clouds - 0.1)
    sun = np.hypot(x - 0.86, y - 0.33)
    sketch = _mix(sketch, [1.0, 0.95, 0.70], np.exp(-((sun / 0.11) ** 2)) + (sun < 0.055))
    angle = np.arctan2(y - 0.33, x - 0.86)
    field = np.stack([-np.sin(angle), np.cos(angle)], -1) + 0.35 * np.stack([clouds, 0 * x], -1)
    edge = 0.47 + 0.03 * np.sin(4 * x + 1) + 0.012 * np.sin(13 * x)
    far = (y > edge - 0.045 * np.clip(np.sin(11 * x) + np.sin(27 * x), 0, 2)) & (y <= edge)
    sketch = np.where(far[..., None], [0.16, 0.17, 0.25], sketch).astype(np.float32)
    field = np.where(far[..., None], np.stack([0.25 + 0 * x, 1 + 0 * x], -1), field)
    ground = y > edge
    near = np.clip((y - edge) / (1 - edge), 0, 1)
    rows = 0.5 + 0.5 * np.sin((x - 0.7) / (0.06 + near) * 9)
    wheat = _mix(np.broadcast_to([0.80, 0.58, 0.16], (H, W, 3)), [0.35, 0.42, 0.12], rows * 0.8)
    wheat = _mix(wheat, [0.18, 0.26, 0.14], (near - 0.5) * 1.2 * rows)
    sketch = np.where(ground[..., None], wheat, sketch).astype(np.float32)
    lean = (x - 0.7) * 0.9 + 0.25 * rolling(rng, 1.5)
    field = np.where(ground[..., None], np.stack([lean, -np.ones_like(lean)], -1), field)
    field = field / np.linalg.norm(field, axis=-1, keepdims=True)
    canvas = Canvas(H, W, (0.45, 0.2, 0.1))
    base = [Layer(34, 130, 26, 0.10), Layer(22, 80, 18, 0.14), Layer(13, 60, 14, 0.14, 0.10)]
    paint(canvas, sketch, field.astype(np.float32), base, rng)
    _petals(rng, canvas, edge)
    return canvas.finished(0.9)


def _petals(rng: np.random.Generator, canvas: Canvas, edge: Picture) -> None:
    """Red dabs, larger towards the front."""
    for _ in range(620):
        near = rng.uniform(0, 1) ** 0.8
        px = rng.uniform(0, W)
        top = float(edge[0, int(min(px, W - 1))])
        py = (top + 0.01 + near * (1 - top)) * H
        size = 5 + 26 * near * rng.uniform(0.6, 1.2)
        red = np.array([0.86, 0.12, 0.07]) * rng.uniform(0.7, 1.2) + rng.normal(0, 0.04, 3)
        for _ in range(3):
            turn, reach = rng.uniform(0, np.pi), size * rng.uniform(0.4, 0.9)
            d = np.array([np.cos(turn), 0.6 * np.sin(turn)])
            middle = np.array([px, py]) + rng.normal(0, 0.25, 2) * size
            bend = np.array([0, -0.3 * reach])
            path = np.stack([middle - d * reach, middle + bend, middle + d * reach])
            fine = np.stack(
                [np.interp(np.linspace(0, 2, 9), [0, 1, 2], path[:, k]) for k in (0, 1)], 1
            )
            shade = red * rng.uniform(0.75, 1.2)
            canvas.stroke(fine, size * 0.7, np.clip(shade, 0, 1).astype(np.float32), rng)
        if near > 0.3:
            heart = np.array([[px - 2, py], [px + 2, py + 2]])
            dark = np.array([0.10, 0.05, 0.10], np.float32)
            canvas.stroke(heart, size * 0.3, dark, rng)
