"""Opacities, sizes and colours in which merged Gaussians look most like the scene they stand for.

One step of Gauss and Newton. What a frame changes by, when a Gaussian becomes more opaque or
larger, follows from its shares (`tracing`) alone: with alpha = opacity exp(-m / 2) at a pixel, a
larger logarithm of the opacity multiplies alpha, one of the scale does so in proportion to m.
"""

# numba infers the types of the kernels.
# mypy: allow-untyped-defs

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.fitting.refit import GREY, Target
from styl3r_cli.fitting.tracing import Trace, pixel_of
from styl3r_cli.gaussians import FloatArray, Gaussians
from styl3r_cli.splatting.compiler import in_threads, kernel
from styl3r_cli.splatting.constants import ALPHA_MAX, DILATION

# A Gaussian's unknowns: three colours, and the logarithms of its opacity and of its scale.
UNKNOWNS, OPACITY, SCALE = 5, 3, 4
# A frame's errors: three colours on grey, and what black and white behind it tell apart beyond
# that, which `squared_errors` counts in each of three colours.
ERRORS, VEIL = 4, 3
VEIL_WEIGHT = np.float32(math.sqrt(3) * 0.5)
# How much the unknowns are held to what they were: a share of their own curvature (Levenberg), and
# a little for those that the frames show next to nothing of.
DAMPING, LEAST_CURVATURE = np.float32(0.05), np.float32(1e-3)
# The frames are straight lines in the unknowns only nearby.
MOST_OPAQUE_CHANGE, MOST_SCALE_CHANGE = 0.5, 0.3
LARGEST = np.float32(2.0**127)  # of scales, so that none becomes infinite


@dataclass(frozen=True)
class Slopes:
    """How a frame changes with what it shows.

    Attributes:
        seen: the frame.
        slopes: (E, 4) change of each share's pixel with the logarithm of the Gaussian's alpha.
        widths: (E,) change of that with the logarithm of its scale.
    """

    seen: Trace
    slopes: FloatArray
    widths: FloatArray

    @classmethod
    def of(cls, seen: Trace, colours: FloatArray, opacities: FloatArray, own: FloatArray) -> Slopes:
        """At the Gaussians' (K, 3) colours and (K,) opacities.

        `own` (K,) says how much of a splat's variance is its Gaussian's, not the pixel's.
        """
        rest = seen.picture + (GREY * seen.through)[:, None]
        slopes = np.empty((len(seen.shares), ERRORS), np.float32)
        widths = np.empty(len(seen.shares), np.float32)
        _differentiate(
            *seen.runs, seen.places, seen.shares, seen.width, colours, opacities, own, rest,
            np.ones(len(rest), np.float32), seen.through, slopes, widths,
        )  # fmt: skip
        return cls(seen, slopes, widths)

    def draw(self, values: FloatArray) -> FloatArray:
        """(P, 4) what changes with (K, 5) unknowns."""
        seen, out = self.seen, np.zeros((len(self.seen.picture), ERRORS), np.float32)
        _draw(
            *seen.runs, seen.places, seen.shares, seen.width, self.slopes, self.widths, values, out
        )
        return out

    def gather(self, values: FloatArray) -> FloatArray:
        """The transposed, times (P, 4): (K, 5)."""
        seen, out = self.seen, np.zeros((self.seen.count, UNKNOWNS), np.float32)
        _gather(
            *seen.runs, seen.places, seen.shares, seen.width, self.slopes, self.widths, values, out
        )
        return out

    def curvature(self) -> FloatArray:
        """(K, 5) sums of squares of the matrix's columns."""
        seen, out = self.seen, np.zeros((self.seen.count, UNKNOWNS), np.float32)
        _curvature(seen.gaussians, seen.starts, seen.shares, self.slopes, self.widths, out)
        return out

    def lacks(self, target: Target) -> FloatArray:
        """(P, 4) what the frame lacks."""
        veil = VEIL_WEIGHT * (target.through - self.seen.through)
        return np.concatenate(
            [target.missing(self.seen.picture, self.seen.through), veil[:, None]], axis=1
        )


def reshape(
    gaussians: Gaussians,
    traces: Sequence[Trace],
    targets: Sequence[Target],
    pixel_sizes: NDArray[np.floating],
    steps: int,
    threads: int | None = None,
) -> Gaussians:
    """The same Gaussians, a step nearer to the targets in opacity, size and colour.

    Conjugate gradients on the normal equations, preconditioned by their diagonal. The step is what
    straight lines foretell: whoever takes it looks whether it helped.

    Args:
        gaussians: K of them.
        traces: of them, a frame each.
        targets: what the frames should look like.
        pixel_sizes: (K,) side of a pixel at each one's depth, scene units.
        steps: of the iteration.
        threads: None for every core.
    """
    widths = np.sort(gaussians.scales, axis=1)[:, 1:] / pixel_sizes.astype(np.float64)[:, None]
    own = (1 - DILATION / (widths.prod(axis=1) + DILATION)).astype(np.float32)

    def each(work: Callable[[int], FloatArray]) -> FloatArray:
        return np.sum(in_threads(work, range(len(traces)), threads), axis=0)

    def slopes(seen: Trace) -> Slopes:
        return Slopes.of(seen, gaussians.colours, gaussians.opacities, own)

    frames = in_threads(slopes, traces, threads)
    curvature = each(lambda n: frames[n].curvature()) + LEAST_CURVATURE
    residual = each(lambda n: frames[n].gather(frames[n].lacks(targets[n])))

    def normal(values: FloatArray) -> FloatArray:
        product = each(lambda n: frames[n].gather(frames[n].draw(values)))
        return product + DAMPING * curvature * values

    change = _conjugate_gradients(normal, np.float32(1) / curvature, residual, steps)
    return _changed(gaussians, change)


def _changed(gaussians: Gaussians, change: FloatArray) -> Gaussians:
    colours = gaussians.colours
    low, high = min(0, colours.min(initial=0)), max(1, colours.max(initial=0))
    opaque = np.exp(np.clip(change[:, OPACITY], -MOST_OPAQUE_CHANGE, MOST_OPAQUE_CHANGE))
    larger = np.exp(np.clip(change[:, SCALE], -MOST_SCALE_CHANGE, MOST_SCALE_CHANGE))
    return replace(
        gaussians,
        scales=np.minimum(gaussians.scales, LARGEST / larger[:, None]) * larger[:, None],
        opacities=np.minimum(gaussians.opacities * opaque, np.float32(ALPHA_MAX)),
        colours=np.clip(colours + change[:, :OPACITY], low, high).astype(np.float32),
    )


def _conjugate_gradients(
    normal: Callable[[FloatArray], FloatArray],
    preconditioner: FloatArray,
    residual: FloatArray,
    steps: int,
) -> FloatArray:
    """Solve normal(x) = residual for all unknowns together (Shewchuk 1994, B3)."""
    solution = np.zeros_like(residual)
    scaled = preconditioner * residual
    direction = scaled.copy()
    before = float((residual * scaled).sum(dtype=np.float64))
    for _ in range(steps):
        product = normal(direction)
        bend = float((direction * product).sum(dtype=np.float64))
        if not (bend > 0 and before > 0):
            break
        length = np.float32(before / bend)
        solution += length * direction
        residual = residual - length * product
        scaled = preconditioner * residual
        after = float((residual * scaled).sum(dtype=np.float64))
        direction = scaled + np.float32(after / before) * direction
        before = after
    return solution


@kernel
def _differentiate(gaussians, corners, starts, places, shares, width, colours, opacities, own, rest,
                   left, through, slopes, widths):  # fmt: skip
    """Shares of a pixel come front to back: `rest` is what is still behind, `left` how much shows.

    A more opaque Gaussian shows more of itself, and less of what is behind.
    """
    for run in range(len(gaussians)):
        g = gaussians[run]
        for i in range(starts[run], starts[run + 1]):
            p, share = pixel_of(corners[run], places[i], width), shares[i]
            alpha = min(share / left[p], np.float32(ALPHA_MAX))
            left[p] = max(left[p] - share, np.float32(0))
            hides = alpha / (np.float32(1) - alpha)
            for c in range(VEIL):
                own_colour = share * colours[g, c]
                rest[p, c] -= own_colour
                slopes[i, c] = own_colour - hides * rest[p, c]
            slopes[i, VEIL] = -VEIL_WEIGHT * hides * through[p]
            off = max(np.float32(0), np.float32(2) * math.log(opacities[g] / alpha))
            widths[i] = off * own[g]


@kernel
def _draw(gaussians, corners, starts, places, shares, width, slopes, widths, values, out):
    for run in range(len(gaussians)):
        g = gaussians[run]
        red, green, blue = values[g, 0], values[g, 1], values[g, 2]
        opaque, larger = values[g, OPACITY], values[g, SCALE]
        for i in range(starts[run], starts[run + 1]):
            p, share = pixel_of(corners[run], places[i], width), shares[i]
            more = opaque + widths[i] * larger
            out[p, 0] += share * red + slopes[i, 0] * more
            out[p, 1] += share * green + slopes[i, 1] * more
            out[p, 2] += share * blue + slopes[i, 2] * more
            out[p, VEIL] += slopes[i, VEIL] * more


@kernel
def _gather(gaussians, corners, starts, places, shares, width, slopes, widths, values, out):
    for run in range(len(gaussians)):
        g = gaussians[run]
        red, green, blue = np.float32(0), np.float32(0), np.float32(0)
        opaque, larger = np.float32(0), np.float32(0)
        for i in range(starts[run], starts[run + 1]):
            p, share = pixel_of(corners[run], places[i], width), shares[i]
            r, g_, b = values[p, 0], values[p, 1], values[p, 2]
            more = slopes[i, VEIL] * values[p, VEIL]
            more += slopes[i, 0] * r + slopes[i, 1] * g_ + slopes[i, 2] * b
            red += share * r
            green += share * g_
            blue += share * b
            opaque += more
            larger += widths[i] * more
        out[g, 0] += red
        out[g, 1] += green
        out[g, 2] += blue
        out[g, OPACITY] += opaque
        out[g, SCALE] += larger


@kernel
def _curvature(gaussians, starts, shares, slopes, widths, out):
    for run in range(len(gaussians)):
        g = gaussians[run]
        for i in range(starts[run], starts[run + 1]):
            share = shares[i]
            squares = slopes[i, VEIL] * slopes[i, VEIL]
            for c in range(VEIL):
                out[g, c] += share * share
                squares += slopes[i, c] * slopes[i, c]
            out[g, OPACITY] += squares
            out[g, SCALE] += widths[i] * widths[i] * squares
