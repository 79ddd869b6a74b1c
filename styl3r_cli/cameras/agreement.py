"""Whether features that match agree with where two cameras are said to be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.matches import Matches
from styl3r_cli.cameras.pose_errors import motion
from styl3r_cli.cameras.two_view import rays, solve

Array = NDArray[np.float64]

# Pixels from the epipolar line within which a motion explains a match: a network's motion is a
# little less exact than one that was fitted to the matches.
NEAR = 2.0
# Rays that meet at a smaller angle say nothing of which side they meet on (radians: 1 degree).
LEAST_ANGLE = np.radians(1.0)
# So many matches, and such a part of all of them, must one motion explain before it counts. Of 122
# groups of real photos, 11 come nearer to the truth, and 2, wrong by 60 degrees and more before, go
# a little farther from it. With 20, a facade that repeats itself is turned the wrong way; with 30,
# one more of two views stays lost.
FEWEST, LEAST_SHARE = 25, 0.6
# The network is wrong where its motion explains less than that part of what another one does.
# Right ones (within 2 degrees) explain 0.87 of it or more, with few exceptions, others hardly any.
CONTRADICTED = 0.7


@dataclass(frozen=True)
class Pair:
    """Two views' matches, beside the network's motion.

    Attributes:
        first: index of a view.
        second: of a later one.
        pixels: (M, 2) each, of the matches.
        motion: (4, 4) from the first camera's frame to the second's, translation of length 1, that
            explains many matches; None if none does, or if the network's does as well.
        explained: (M,) the matches that it explains, or the network's.
        confirmed: whether the network's explains as many, and these are enough to count.
    """

    first: int
    second: int
    pixels: tuple[Array, Array]
    motion: Array | None
    explained: NDArray[np.bool_]
    confirmed: bool


def compare(matches: Matches, cameras: list[Camera]) -> Pair:
    """See what explains two views' matches.

    Args:
        matches: of their features.
        cameras: all views', as the network has them.
    """
    pixels, index = matches.pixels, (matches.first, matches.second)
    one, two = (cameras[view] for view in index)
    enough = max(FEWEST, LEAST_SHARE * len(pixels[0]))
    ours = explained(motion(one.extrinsics, two.extrinsics), pixels, one, two)
    if len(pixels[0]) < FEWEST or ours.sum() >= CONTRADICTED * len(ours):
        return Pair(*index, pixels, None, ours, bool(ours.sum() >= enough))
    other = solve(*pixels, one.intrinsics, two.intrinsics)
    if other is None:
        return Pair(*index, pixels, None, ours, confirmed=False)
    theirs = explained(other, pixels, one, two)
    if theirs.sum() < enough:
        return Pair(*index, pixels, None, ours, confirmed=False)
    if ours.sum() >= CONTRADICTED * theirs.sum():
        return Pair(*index, pixels, None, ours, confirmed=True)
    return Pair(*index, pixels, other, theirs, confirmed=False)


def explained(
    move: Array, pixels: tuple[Array, Array], one: Camera, two: Camera, within: float = NEAR
) -> NDArray[np.bool_]:
    """(M,) matches that a motion explains: near their epipolar lines, and in front of both cameras.

    Args:
        move: (4, 4) from the first camera's frame to the second's; its length plays no part.
        pixels: (M, 2) of the matches in both.
        one: the first camera's intrinsics.
        two: the second's.
        within: so many pixels of the lines.
    """
    a, b = (rays(uv, camera.intrinsics) for uv, camera in zip(pixels, (one, two), strict=True))
    turned, step = a @ move[:3, :3].T, move[:3, 3]
    length = np.linalg.norm(step)
    with np.errstate(divide="ignore", invalid="ignore"):  # what is not finite explains nothing
        if not length > 0:
            off = np.linalg.norm(turned[:, :2] / turned[:, 2:] - b[:, :2], axis=1)
            return (off * two.fx < within) & (turned[:, 2] > 0)
        step = step / length
        essential = np.cross(step, move[:3, :3], axisb=0, axisc=0)
        line, back = a @ essential.T, b @ essential
        slopes = np.square(line[:, :2]).sum(axis=1) + np.square(back[:, :2]).sum(axis=1)
        off = np.abs((b * line).sum(axis=1)) / np.sqrt(slopes)  # Sampson's distance
        near, far, sine = _meeting(turned, b, step)
    return (off * two.fx < within) & ((sine < np.sin(LEAST_ANGLE)) | ((near > 0) & (far > 0)))


def _meeting(turned: Array, b: Array, step: Array) -> tuple[Array, Array, Array]:
    """How far along both rays of each match they are nearest to each other, and the angle's sine.

    Least squares of turned x + step = b y.
    """
    aa, bb, ab = (turned * turned).sum(1), (b * b).sum(1), (turned * b).sum(1)
    at, bt = turned @ step, b @ step
    bend = np.maximum(aa * bb - ab * ab, np.finfo(np.float64).tiny)
    return (ab * bt - at * bb) / bend, (aa * bt - ab * at) / bend, np.sqrt(bend / (aa * bb))
