"""From linear light to the picture a phone would store, and what varies from shot to shot."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

#: Largest blur by defocus (pixels, standard deviation).
WIDEST_BLUR = 4.0
#: Share of scenes photographed with a shallow depth of field.
SHALLOW = 0.1
#: Geometric mean brightness of a picture (linear, before the tone curve): night to glare.
KEY = (0.11, 0.38)


@dataclass(frozen=True)
class Shot:
    """Settings of one photograph. The defaults are a clean camera.

    Attributes:
        gain: exposure and white balance, linear RGB.
        blur: of the whole picture, pixels at 256.
        vignette: darkening of the corners.
        contrast: about middle grey, after the tone curve.
        sharpen: unsharp mask, as phones apply it.
        noise: deviation of the grain in shadows.
        jpeg: quality, 0 for none.
        aperture: blur of the infinitely far when focused nearby, pixels at 256; 0 is a pinhole.
        focus: depth that is sharp, in the depth map's unit.
    """

    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    blur: float = 0.0
    vignette: float = 0.0
    contrast: float = 1.0
    sharpen: float = 0.0
    noise: float = 0.0
    jpeg: int = 0
    aperture: float = 0.0
    focus: float = 1.0


def exposure(linear: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """(3,) factors to a usual brightness and a greyer mean, as a camera's automatics do."""
    bright = np.minimum(linear, 4.0)
    level = float(np.exp(np.log(bright.mean(-1) + 0.02).mean()))
    mean = bright.mean((0, 1)) + 1e-3
    balance = (mean.mean() / mean) ** rng.uniform(0.3, 0.8)
    return (np.exp(rng.uniform(*np.log(KEY))) / level * balance).astype(np.float32)


def draw_shots(rng: np.random.Generator, views: int, depth: float) -> list[Shot]:
    """Per-view variation: mostly slight, as automatic exposure and white balance drift."""
    drift = float(rng.choice([0.0, 0.03, 0.10], p=[0.2, 0.6, 0.2]))
    cast = float(rng.choice([0.0, 0.01, 0.04], p=[0.3, 0.5, 0.2]))
    base = np.exp(rng.normal(0, 0.06, 3))
    blur, vignette = float(rng.choice([0.0, 0.35, 0.7])), float(rng.uniform(0, 0.25))
    contrast, sharpen = float(rng.uniform(1.0, 1.35)), float(rng.choice([0.0, 0.3, 0.8]))
    noise, jpeg = float(rng.choice([0.0, 0.008, 0.025])), int(rng.choice([0, 92, 75]))
    aperture = float(rng.uniform(0.4, 2.5)) if rng.random() < SHALLOW else 0.0
    shots = []
    for _ in range(views):
        gain = base * np.exp(rng.normal(0, drift) + rng.normal(0, cast, 3))
        shots.append(
            Shot(
                tuple(gain.tolist()),
                blur,
                vignette,
                contrast,
                sharpen,
                noise,
                jpeg,
                aperture,
                depth,
            )
        )
    return shots


def tone(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """SRGB in [0, 1] from linear light with a soft shoulder instead of hard clipping."""
    x = 1.0 - np.exp(-1.25 * np.maximum(linear, np.float32(0)))
    return np.where(x < 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055).astype(np.float32)


def _defocused(
    image: NDArray[np.floating], depth: NDArray[np.float32], shot: Shot
) -> NDArray[np.floating]:
    """Depth of field: a blend of blurs, by each pixel's circle of confusion."""
    radius = shot.aperture * min(image.shape[:2]) / 256 * np.abs(1 - shot.focus / depth)
    radius = np.minimum(radius, WIDEST_BLUR)[..., None]
    half, full = (
        np.asarray(cv2.GaussianBlur(image, (0, 0), s)) for s in (WIDEST_BLUR / 2, WIDEST_BLUR)
    )
    step = radius * 2 / WIDEST_BLUR
    near = image + np.minimum(step, 1) * (half - image)
    return np.asarray(near + np.clip(step - 1, 0, 1) * (full - half))


def develop(
    linear: NDArray[np.float32],
    shot: Shot,
    rng: np.random.Generator,
    depth: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """One exposed linear picture (H, W, 3) to sRGB (H, W, 3) in [0, 1].

    Args:
        linear: the picture.
        shot: how it is taken.
        rng: for the grain.
        depth: (H, W) camera depth, needed only where the shot has an aperture.
    """
    image: NDArray[np.floating] = linear * np.asarray(shot.gain, np.float32)
    height, width = image.shape[:2]
    if shot.aperture > 0 and depth is not None:
        image = _defocused(image, depth, shot)
    if shot.blur > 0:
        sigma = shot.blur * min(height, width) / 256
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.float32)
    if shot.vignette > 0:
        y, x = np.mgrid[0:height, 0:width].astype(np.float32)
        r2 = ((x / width - 0.5) ** 2 + (y / height - 0.5) ** 2) * 2
        image = image * (1 - shot.vignette * r2[..., None] ** 1.5)
    image = tone(image.astype(np.float32))
    if shot.contrast != 1.0:  # about middle grey
        image = 0.45 + shot.contrast * (image - 0.45)
    if shot.sharpen > 0:
        smooth = cv2.GaussianBlur(image, (0, 0), 1.0)
        image = image + shot.sharpen * (image - smooth)
    if shot.noise > 0:
        grain = rng.standard_normal(image.shape, dtype=np.float32) * shot.noise
        image = image + grain * (0.4 + 0.6 * (1 - image))
    image = np.clip(image, 0, 1).astype(np.float32)
    if shot.jpeg:
        codes = (image[..., ::-1] * 255 + 0.5).astype(np.uint8)
        _, data = cv2.imencode(".jpg", codes, [cv2.IMWRITE_JPEG_QUALITY, shot.jpeg])
        decoded = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR))[..., ::-1]
        image = decoded.astype(np.float32) / 255
    return image.astype(np.float32)
