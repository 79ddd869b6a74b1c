"""A painter's hand: bristled strokes along a flow field, layer by layer, with impasto."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.floating]
#: Strokes are laid at twice the final resolution, which also softens their edges.
FINER = 2
#: Pixels between the bristles of a brush.
BRISTLE_GAP = 3.0


@dataclass(frozen=True)
class Layer:
    """One pass over the canvas.

    Attributes:
        width: of the brush, pixels.
        length: of a stroke.
        gap: between the starts of strokes; below width they cover.
        jitter: of colours, from stroke to stroke.
        tolerance: strokes stay out where the canvas is this close to the sketch already.
    """

    width: float
    length: float
    gap: float
    jitter: float
    tolerance: float = 0.0


class Canvas:
    """Paint with a height, so that light rakes over the strokes."""

    def __init__(self, height: int, width: int, ground: tuple[float, float, float]) -> None:
        self.colour = np.empty((height, width, 3), np.uint8)
        self.colour[:] = np.asarray(ground) * 255
        self.relief = np.full((height, width), 40, np.uint8)

    def stroke(
        self, path: NDArray[np.float64], width: float, colour: Picture, rng: np.random.Generator
    ) -> None:
        """Drag a loaded brush along a path (n, 2) of x, y pixels."""
        ahead = np.gradient(path, axis=0)
        ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-6)
        side = np.stack([-ahead[:, 1], ahead[:, 0]], 1)
        count = max(int(width / BRISTLE_GAP), 1)
        load = rng.uniform(0.85, 1.0)
        for k in rng.permutation(count):
            across = (k + 0.5) / count - 0.5
            # The tuft is round: outer bristles touch later and lift earlier.
            short = int(len(path) * 0.22 * abs(2 * across) ** 2 * rng.uniform(0.3, 1.6))
            line = path[short : len(path) - short]
            if len(line) < 2:
                continue
            line = line + side[short : len(path) - short] * across * width
            shade = load * (1 + rng.normal(0, 0.05))
            tint = np.clip(colour * shade * 255, 0, 255)
            points = [np.round(line * 8).astype(np.int32)]
            thick = int(BRISTLE_GAP + 1 + rng.integers(0, 2))
            cv2.polylines(self.colour, points, False, tint.tolist(), thick, cv2.LINE_AA, 3)
            ridge = 70 + 130 * abs(2 * across) ** 2 + rng.normal(0, 40)
            value = float(np.clip(ridge, 0, 255))
            cv2.polylines(self.relief, points, False, value, thick, cv2.LINE_AA, 3)

    def finished(self, relief: float = 0.5, weave: float = 0.02) -> NDArray[np.uint8]:
        """The painting at half size under raking light, (h, w, 3) uint8 sRGB."""
        h, w = self.relief.shape[0] // FINER, self.relief.shape[1] // FINER
        height = cv2.GaussianBlur(self.relief.astype(np.float32) / 255, (0, 0), 1.1)
        slope = cv2.Sobel(height, cv2.CV_32F, 1, 0) + cv2.Sobel(height, cv2.CV_32F, 0, 1)
        y, x = np.mgrid[0 : h * FINER, 0 : w * FINER]
        cloth = weave * (np.sin(x * np.pi / 3) + np.sin(y * np.pi / 3))
        light = 1 + relief * np.clip(-slope, -0.5, 0.5) * 0.55 + cloth
        picture = self.colour.astype(np.float32) * light[..., None]
        picture = cv2.resize(picture, (w, h), interpolation=cv2.INTER_AREA)
        return np.clip(picture, 0, 255).astype(np.uint8)


def trace(
    field: NDArray[np.float32], start: NDArray[np.float64], length: float, step: float = 5.0
) -> NDArray[np.float64]:
    """Follow unit directions (H, W, 2) both ways from a point; (n, 2) pixels."""
    height, width = field.shape[:2]
    halves = []
    for sign in (1.0, -1.0):
        p, last, points = start.copy(), None, [start.copy()]
        for _ in range(max(int(length / step / 2), 1)):
            i, j = int(np.clip(p[1], 0, height - 1)), int(np.clip(p[0], 0, width - 1))
            d = field[i, j] * sign
            if last is not None and d @ last < 0:
                d = -d
            p, last = p + step * d, d
            points.append(p.copy())
        halves.append(points)
    return np.array(halves[1][:0:-1] + halves[0])


def paint(
    canvas: Canvas,
    sketch: Picture,
    field: NDArray[np.float32],
    layers: list[Layer],
    rng: np.random.Generator,
    mask: NDArray[np.bool_] | None = None,
) -> None:
    """Cover a canvas with strokes that take their colours from a sketch.

    Args:
        canvas: what is painted on.
        sketch: (H, W, 3) sRGB in [0, 1].
        field: (H, W, 2) unit directions of strokes.
        layers: passes, usually from broad to fine.
        rng: random source.
        mask: (H, W) where strokes may start; None is everywhere.
    """
    height, width = sketch.shape[:2]
    for layer in layers:
        smooth = cv2.GaussianBlur(sketch, (0, 0), layer.width / 2.5)
        ys, xs = np.mgrid[0 : height : layer.gap, 0 : width : layer.gap]
        starts = np.stack([xs.ravel(), ys.ravel()], 1)
        starts = starts + rng.uniform(-0.6, 0.6, starts.shape) * layer.gap
        for start in rng.permutation(starts):
            i, j = int(np.clip(start[1], 0, height - 1)), int(np.clip(start[0], 0, width - 1))
            if mask is not None and not mask[i, j]:
                continue
            colour = smooth[i, j]
            if (
                layer.tolerance
                and np.abs(canvas.colour[i, j] / 255 - colour).max() < layer.tolerance
            ):
                continue
            path = trace(field, start, layer.length * rng.uniform(0.6, 1.3))
            colour = colour * np.float32(np.exp(rng.normal(0, layer.jitter)))
            colour = colour + rng.normal(0, layer.jitter / 2, 3).astype(np.float32)
            canvas.stroke(path, layer.width * rng.uniform(0.75, 1.2), np.clip(colour, 0, 1), rng)


def along(gradient_x: Picture, gradient_y: Picture) -> NDArray[np.float32]:
    """Unit directions (H, W, 2) along the level lines of a field with this gradient."""
    field = np.stack([-gradient_y, gradient_x], -1)
    length = np.maximum(np.linalg.norm(field, axis=-1, keepdims=True), 1e-9)
    return (field / length).astype(np.float32)
