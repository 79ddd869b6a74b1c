"""Through the views' cameras, in their order: a smooth curve, travelled at constant speed."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras import poses
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.course import Course

Array = NDArray[np.float64]

# Samples between two views from which the speed is evened out: no step in it can be seen.
SAMPLES = 256
# Views nearer to each other than this share of the whole way are one stop: a curve through two
# equal points has no direction between them.
SAME_PLACE = 1e-3


def tour(cameras: Sequence[Camera], depth: float, amplitude: float = 1.0) -> Course:
    """A course through all cameras, whose speed is even as a viewer sees it.

    The curve is a centripetal Catmull-Rom spline (Yuksel et al. 2011), which neither overshoots nor
    loops between stops that are unevenly apart, on rotations and positions together.

    Args:
        cameras: at least one; the frames take the first one's size.
        depth: of the scene, in its units: how far away a turn moves what is seen.
        amplitude: how much of the way to go, at most 1.
    """
    first = cameras[0]
    stops = _apart(
        [poses.from_camera(c.resized(first.width, first.height)) for c in cameras], depth
    )
    if len(stops) == 1:
        return Course(lambda _: poses.to_camera(stops[0], first), closed=False, eased=True)
    times = np.concatenate([[0.0], np.cumsum(np.sqrt(_steps(stops, depth)))])
    # Beyond both ends the curve goes on as it came.
    around = [
        poses.blend(stops[0], stops[1], -1.0),
        *stops,
        poses.blend(stops[-1], stops[-2], -1.0),
    ]
    knots = np.array([2 * times[0] - times[1], *times, 2 * times[-1] - times[-2]])

    def pose(time: float) -> Array:
        segment = min(max(int(np.searchsorted(times, time, "right")) - 1, 0), len(stops) - 2)
        part = slice(segment, segment + 4)
        return poses.catmull_rom(around[part], knots[part], time)

    samples = np.concatenate(
        [np.linspace(a, b, SAMPLES, endpoint=False) for a, b in pairwise(times)] + [times[-1:]]
    )
    way = np.concatenate([[0.0], np.cumsum(_steps([pose(t) for t in samples.tolist()], depth))])
    reach = way[-1] * min(amplitude, 1.0)

    def at(place: float) -> Camera:
        return poses.to_camera(pose(float(np.interp(place * reach, way, samples))), first)

    return Course(at, closed=False, eased=True)


def _apart(stops: Sequence[Array], depth: float) -> list[Array]:
    """The stops, without those that are where the one before them is."""
    whole = float(_steps(stops, depth).sum())
    kept = [stops[0]]
    for stop in stops[1:]:
        if _steps([kept[-1], stop], depth)[0] > SAME_PLACE * whole:
            kept.append(stop)
    return kept


def _steps(stops: Sequence[Array], depth: float) -> Array:
    """How far each pose is from the one before it, in scene units.

    A turn by an angle moves what is seen about as much as a step of angle times depth, and so does
    a zoom by that logarithm.
    """
    values = np.array(stops)
    moved = np.linalg.norm(np.diff(values[:, 4:7], axis=0), axis=1)
    cosines = np.abs((values[1:, :4] * values[:-1, :4]).sum(axis=1)).clip(0, 1)
    zoomed = np.diff(np.log(values[:, 7]))
    return np.sqrt(moved**2 + depth**2 * ((2 * np.arccos(cosines)) ** 2 + zoomed**2))
