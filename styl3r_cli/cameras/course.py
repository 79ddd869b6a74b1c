"""A camera's way through a scene, and when it is where."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from styl3r_cli.cameras.camera import Camera


@dataclass(frozen=True)
class Course:
    """A curve of cameras.

    Attributes:
        at: the camera at a place from 0, the beginning, to 1, the end.
        closed: whether the end is the beginning; a loop then goes around, else there and back.
        eased: whether it is slow at its ends unless asked otherwise.
        start: where in a loop the first frame is, as a share of its time.
    """

    at: Callable[[float], Camera]
    closed: bool
    eased: bool
    start: float = 0.0


def frames_along(
    course: Course, frames: int, loop: bool = True, eased: bool | None = None
) -> list[Camera]:
    """The cameras of a video's frames.

    Args:
        course: where to go.
        frames: how many, at least 1.
        loop: come back to the start, so that the frame after the last would be the first;
            otherwise go once from the beginning to the end.
        eased: speed up slowly and slow down again, or move at constant speed; by default as the
            course does.
    """
    soft = course.eased if eased is None else eased
    around = (np.arange(frames) / frames + course.start) % 1.0
    times = around if loop else np.linspace(0, 1, frames)
    return [course.at(_place(time, loop and not course.closed, soft)) for time in times.tolist()]


def _place(time: float, back: bool, eased: bool) -> float:
    """Where on the course, 0 to 1, a share of the time has led."""
    if back:
        time = 1 - abs(1 - 2 * time)  # up to 1, and down again
    return 0.5 - 0.5 * math.cos(math.pi * time) if eased else time
