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
from styl3r_cli.splatting.compiler import inlined, kernel
from styl3r_cli.splatting.constants import ALPHA_MAX, DILATION
from styl3r_cli.threads import in_threads

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

_ZERO, _ALPHA_MAX = np.float32(0), np.float32(ALPHA_MAX)
_MOST_HIDDEN = np.float32(ALPHA_MAX / (1 - ALPHA_MAX))


@dataclass(frozen=True)
class Slopes:
    """How a frame changes with what it shows.

    The changes themselves would take four times the memory of the shares: each product works them
    out anew, front to back.

    Attributes:
        seen: the frame.
        colours: (K, 3) of the Gaussians.
        widths: (E,) change of the logarithm of each share's alpha with that of the scale.
    """

    seen: Trace
    colours: FloatArray
    widths: FloatArray

    @classmethod
    def of(cls, seen: Trace, colours: FloatArray, opacities: FloatArray, own: FloatArray) -> Slopes:
        """At the Gaussians' (K, 3) colours and (K,) opacities.

        `own` (K,) says how much of a splat's variance is its Gaussian's, not the pixel's.
        """
        widths = np.empty(len(seen.shares), np.float32)
        left = np.ones(len(seen.through), np.float32)
        _widths(*seen.runs, seen.places, seen.shares, seen.width, opacities, own, left, widths)
        return cls(seen, colours, widths)

    def draw(self, values: FloatArray) -> FloatArray:
        """(P, 4) what changes with (K, 5) unknowns."""
        out = np.zeros((len(self.seen.picture), ERRORS), np.float32)
        _draw(*self._matrix(), values, out)
        return out

    def gather(self, values: FloatArray) -> FloatArray:
        """The transposed, times (P, 4): (K, 5)."""
        out = np.zeros((self.seen.count, UNKNOWNS), np.float32)
        _gather(*self._matrix(), values, out)
        return out

    def curvature(self) -> FloatArray:
        """(K, 5) sums of squares of the matrix's columns."""
        out = np.zeros((self.seen.count, UNKNOWNS), np.float32)
        _curvature(*self._matrix(), out)
        return out

    def _matrix(self) -> tuple[object, ...]:
        """What the kernels work it out from; the last two are theirs to change."""
        seen = self.seen
        rest = seen.picture + (GREY * seen.through)[:, None]
        left = np.ones(len(rest), np.float32)
        listed = *seen.runs, seen.places, seen.shares, seen.width
        return *listed, self.widths, self.colours, seen.through, rest, left

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


@inlined
def _slopes(share, p, red, green, blue, through, rest, left):
    """How a share's pixel changes with the logarithm of its alpha: three colours and the veil.

    Shares of a pixel come front to back: `rest` is what is still behind, `left` how much of that
    shows. A more opaque Gaussian shows more of itself, and less of what is behind.
    """
    left[p] = max(left[p] - share, _ZERO)
    hides = min(share / left[p], _MOST_HIDDEN)  # alpha / (1 - alpha)
    r, g, b = share * red, share * green, share * blue
    rest[p, 0] -= r
    rest[p, 1] -= g
    rest[p, 2] -= b
    r, g, b = r - hides * rest[p, 0], g - hides * rest[p, 1], b - hides * rest[p, 2]
    return r, g, b, -VEIL_WEIGHT * hides * through[p]


@kernel
def _widths(gaussians, corners, starts, places, shares, width, opacities, own, left, widths):
    for run in range(len(gaussians)):
        g = gaussians[run]
        for i in range(np.uintp(starts[run]), np.uintp(starts[run + 1])):
            p, share = pixel_of(corners[run], places[i], width), shares[i]
            alpha = min(share / left[p], _ALPHA_MAX)
            left[p] = max(left[p] - share, _ZERO)
            widths[i] = max(_ZERO, np.float32(2) * math.log(opacities[g] / alpha)) * own[g]


@kernel
def _draw(gaussians, corners, starts, places, shares, width, widths, colours, through, rest, left,
          values, out):  # fmt: skip
    for run in range(len(gaussians)):
        g = gaussians[run]
        red, green, blue = colours[g, 0], colours[g, 1], colours[g, 2]
        for i in range(np.uintp(starts[run]), np.uintp(starts[run + 1])):
            p, share = pixel_of(corners[run], places[i], width), shares[i]
            r, gr, b, veil = _slopes(share, p, red, green, blue, through, rest, left)
            more = values[g, OPACITY] + widths[i] * values[g, SCALE]
            out[p, 0] += share * values[g, 0] + r * more
            out[p, 1] += share * values[g, 1] + gr * more
            out[p, 2] += share * values[g, 2] + b * more
            out[p, VEIL] += veil * more


@kernel
def _gather(gaussians, corners, starts, places, shares, width, widths, colours, through, rest, left,
            values, out):  # fmt: skip
    for run in range(len(gaussians)):
        g = gaussians[run]
        red, green, blue = colours[g, 0], colours[g, 1], colours[g, 2]
        for i in range(np.uintp(starts[run]), np.uintp(starts[run + 1])):
            p, share = pixel_of(corners[run], places[i], width), shares[i]
            r, gr, b, veil = _slopes(share, p, red, green, blue, through, rest, left)
            more = r * values[p, 0] + gr * values[p, 1] + b * values[p, 2] + veil * values[p, VEIL]
            for c in range(VEIL):
                out[g, c] += share * values[p, c]
            out[g, OPACITY] += more
            out[g, SCALE] += widths[i] * more


@kernel
def _curvature(gaussians, corners, starts, places, shares, width, widths, colours, through, rest,
               left, out):  # fmt: skip
    for run in range(len(gaussians)):
        g = gaussians[run]
        red, green, blue = colours[g, 0], colours[g, 1], colours[g, 2]
        for i in range(np.uintp(starts[run]), np.uintp(starts[run + 1])):
            p, share = pixel_of(corners[run], places[i], width), shares[i]
            r, gr, b, veil = _slopes(share, p, red, green, blue, through, rest, left)
            squares = r * r + gr * gr + b * b + veil * veil
            for c in range(VEIL):
                out[g, c] += share * share
            out[g, OPACITY] += squares
            out[g, SCALE] += widths[i] * widths[i] * squares
