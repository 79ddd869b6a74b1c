"""The splatting formula in rational numbers: every step exact but the exponential.

A float is a rational number, so is all that EWA splatting does to it up to exp: rotations need no
square root (a quaternion is divided by its squared length), and neither does the inverse of a
covariance. What comes out holds for needles, giants and dust alike, where float64 would cancel.
Slow: a handful of Gaussians, a few hundred pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import Gaussians

# How near to a threshold (relative) a float32 renderer may decide the other way.
BAND = 1e-4
# exp(-x) for larger x is far below any threshold; float would overflow on the way.
FARTHEST_POWER = 1000
MARGIN = Fraction(0.3)

Rows = list[list[Fraction]]


@dataclass(frozen=True)
class Exact:
    """Values of P pixels, and whether a threshold is too close to call there."""

    colour: NDArray[np.float64]
    alpha: NDArray[np.float64]
    depth: NDArray[np.float64]
    borderline: NDArray[np.bool_]


def everywhere(camera: Camera) -> NDArray[np.int64]:
    """(P, 2): column and row of all of a frame's pixels, row by row."""
    y, x = np.mgrid[0 : camera.height, 0 : camera.width]
    return np.stack([x.ravel(), y.ravel()], -1)


def draw_exactly(
    gaussians: Gaussians,
    camera: Camera,
    background: tuple[float, float, float],
    near: float,
    pixels: NDArray[np.int64] | None = None,
) -> Exact:
    """The picture at some pixels (P, 2), by default at all of them."""
    pixels = everywhere(camera) if pixels is None else pixels
    splats = [_splat(gaussians, i, camera) for i in range(len(gaussians))]
    shown = [s for s in splats if s is not None and s[0] > Fraction(near)]
    shown.sort(key=lambda splat: float(np.float32(float(splat[0]))))  # stable, as floats sort
    count = len(pixels)
    colour, depth, transmittance = np.zeros((count, 3)), np.zeros(count), np.ones(count)
    done, borderline = np.zeros(count, bool), np.zeros(count, bool)
    for z, (u, v), inverse, opacity, own in shown:
        powers = _powers(inverse, u, v, pixels)
        alpha = np.minimum(0.99, opacity * np.exp(-0.5 * powers))
        seen = (alpha >= 1 / 255) & ~done
        after = transmittance * (1 - alpha)
        borderline |= ~done & (np.abs(alpha * 255 - 1) < BAND)
        borderline |= seen & (np.abs(after / 1e-4 - 1) < BAND)
        done |= seen & (after < 1e-4)
        weight = np.where(seen & ~done, alpha * transmittance, 0)
        colour += weight[:, None] * np.maximum(own, 0)
        depth += weight * float(z)
        transmittance = np.where(seen & ~done, after, transmittance)
    alpha = 1 - transmittance
    colour += transmittance[:, None] * np.array(background)
    depth = np.divide(depth, alpha, out=np.zeros(count), where=alpha > 0)
    return Exact(colour, alpha, depth, borderline)


def _splat(gaussians: Gaussians, i: int, camera: Camera):
    """Depth, centre, inverse covariance, opacity and colour; None behind the camera."""
    view = [[Fraction(value) for value in row] for row in camera.extrinsics.tolist()]
    mean = [Fraction(value) for value in gaussians.means[i].tolist()]
    x, y, z = (sum(r[k] * mean[k] for k in range(3)) + r[3] for r in view[:3])
    if z <= 0:
        return None
    fx, fy, cx, cy = (Fraction(float(f)) for f in (camera.fx, camera.fy, camera.cx, camera.cy))
    slope_x = _clamped(x / z, fx, cx, camera.width)
    slope_y = _clamped(y / z, fy, cy, camera.height)
    turn = _rotation([Fraction(value) for value in gaussians.rotations[i].tolist()])
    sigmas = [Fraction(value) for value in gaussians.scales[i].tolist()]
    rows: Rows = [[], []]
    for k in range(3):
        axis = [sum(view[r][j] * turn[j][k] for j in range(3)) * sigmas[k] for r in range(3)]
        rows[0].append(fx / z * (axis[0] - slope_x * axis[2]))
        rows[1].append(fy / z * (axis[1] - slope_y * axis[2]))
    blur = Fraction(0.3)
    xx = sum(a * a for a in rows[0]) + blur
    yy = sum(a * a for a in rows[1]) + blur
    xy = sum(a * b for a, b in zip(*rows, strict=True))
    det = xx * yy - xy * xy
    inverse = (yy / det, -xy / det, xx / det)
    own = gaussians.colours[i].astype(np.float64)
    return z, (fx * x / z + cx, fy * y / z + cy), inverse, float(gaussians.opacities[i]), own


def _clamped(slope: Fraction, focal: Fraction, centre: Fraction, length: int) -> Fraction:
    """Where the Jacobian is taken: at most 0.3 tan(fov / 2) outside the frame."""
    margin = MARGIN * length / (2 * focal)
    return min(max(slope, -centre / focal - margin), (length - centre) / focal + margin)


def _rotation(q: list[Fraction]) -> Rows:
    """The rotation of any quaternion w x y z but zero, by its squared length."""
    w, x, y, z = q
    s = 2 / (w * w + x * x + y * y + z * z)
    return [
        [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
    ]


def _powers(
    inverse: tuple[Fraction, Fraction, Fraction],
    u: Fraction,
    v: Fraction,
    pixels: NDArray[np.int64],
) -> NDArray[np.float64]:
    """(P,) squared distances in sigmas: whole numbers over one denominator, rounded at the end."""
    ud, vd = u.denominator, v.denominator
    a, b, c = inverse[0] * vd * vd, 2 * inverse[1] * ud * vd, inverse[2] * ud * ud
    common = math.lcm(a.denominator, b.denominator, c.denominator)
    a_, b_, c_ = (f.numerator * (common // f.denominator) for f in (a, b, c))
    denominator = 4 * ud * ud * vd * vd * common
    powers = []
    for x, y in pixels.tolist():
        dx, dy = (2 * x + 1) * ud - 2 * u.numerator, (2 * y + 1) * vd - 2 * v.numerator
        numerator = (a_ * dx + b_ * dy) * dx + c_ * dy * dy
        far = numerator > FARTHEST_POWER * denominator
        powers.append(float(FARTHEST_POWER) if far else numerator / denominator)
    return np.array(powers)
