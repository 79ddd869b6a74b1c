"""Movements made to fit: the scene stays in the frame, and the camera out of the scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.course import Course
from styl3r_cli.cameras.extent import GRID, Extent

# What a movement may cost: this share of the frame that had the scene behind it keeps it, and
# the nearest thing comes nearer by this factor at most. Otherwise the movement is made smaller.
LEAST_COVERAGE, LEAST_CLEARANCE = 0.93, 0.5
CHECKED = 16  # places on a course where that is measured
HALVINGS = 6  # of the interval in which the largest possible movement is sought
# The frame is then narrowed until the edges of the scene are outside of it, or this much.
EDGES_OUTSIDE, MOST_ZOOM, ZOOM_STEPS = 0.997, 1.15, 6


def largest_reach(sized: Callable[[float], Course], start: Camera, extent: Extent) -> float:
    """How much of a movement, up to 1, has the scene in the frame and the camera out of it.

    Args:
        sized: the movement in a size from 0 to 1.
        start: the view that it starts from, to compare with.
        extent: the scene.
    """
    coverage = LEAST_COVERAGE * extent.coverage(start)
    clearance = LEAST_CLEARANCE * extent.clearance(start)

    def fits(reach: float) -> bool:
        return all(
            extent.clearance(camera) >= clearance and extent.coverage(camera) >= coverage
            for camera in _samples(sized(reach))
        )

    if fits(1.0):
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low or 0.5**HALVINGS


def without_edges(course: Course, start: Camera, extent: Extent) -> Course:
    """The course with a slightly longer lens, where the scene would end inside the frame."""
    wanted = EDGES_OUTSIDE * extent.coverage(start)
    cameras = _samples(course)
    cell = 1 + 1 / GRID  # an edge inside a cell of the grid is not seen by it: look that far out
    zoom = 1.0
    for zoom in np.linspace(1, MOST_ZOOM, ZOOM_STEPS).tolist():
        if all(extent.coverage(zoomed(camera, zoom / cell)) >= wanted for camera in cameras):
            break
    if zoom == 1.0:
        return course
    return replace(course, at=lambda place: zoomed(course.at(place), zoom))


def zoomed(camera: Camera, factor: float) -> Camera:
    """The camera with its focal lengths multiplied; the frame's centre stays where it is."""
    return replace(
        camera,
        fx=camera.fx * factor,
        fy=camera.fy * factor,
        cx=camera.width / 2 + (camera.cx - camera.width / 2) * factor,
        cy=camera.height / 2 + (camera.cy - camera.height / 2) * factor,
    )


def _samples(course: Course) -> Sequence[Camera]:
    return [course.at(place) for place in np.linspace(0, 1, CHECKED).tolist()]
