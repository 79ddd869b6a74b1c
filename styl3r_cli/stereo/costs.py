"""How unlike two views look where a surface is supposed to be: windows compared by correlation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.pointmap import pixel_centres
from styl3r_cli.gaussians import FloatArray

# Pixels across the windows that are compared. With 3 fewer surfaces are found (real photos, 4
# views), with 7 and 9 edges get wider.
WINDOW = 5
# Contrast (a variance of grey in [0, 1]) that counts as noise: two hundredths.
NOISE = 4e-4
# The cost of what the other view's frame does not show: hardly better than no likeness at all, so
# that any likeness wins.
UNSEEN = 0.45
OUTSIDE = -1.0  # a grey that no picture has, beyond its frame
NOWHERE = -9.0  # pixels: a place that no frame shows


@dataclass(frozen=True)
class Look:
    """A view's picture at some size, with its camera at that size.

    Attributes:
        grey: (H, W) in [0, 1].
        camera: its camera; its frame is H x W.
    """

    grey: FloatArray
    camera: Camera

    @classmethod
    def of(cls, picture: NDArray[np.uint8], camera: Camera, size: tuple[int, int]) -> Look:
        """That of an (h, w, 3) RGB picture of any size, at (height, width)."""
        grey = resized(np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), np.uint8), size)
        return cls(grey.astype(np.float32) / np.float32(255), camera.resized(size[1], size[0]))

    @property
    def to_pixels(self) -> NDArray[np.float64]:
        """(3, 3) intrinsics for OpenCV, which has the first pixel's centre at (0, 0)."""
        shift = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])
        return shift @ self.camera.intrinsics


def resized(picture: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """A picture at (height, width), each pixel the mean of what it covers."""
    if picture.shape[:2] == size:
        return picture
    return np.asarray(cv2.resize(picture, size[::-1], interpolation=cv2.INTER_AREA), np.uint8)


def plane_costs(first: Look, others: Sequence[Look], nearness: NDArray[np.floating]) -> FloatArray:
    """Costs of planes that face a view (Collins 1996): (D, H, W) in [0, 1].

    Args:
        first: the view.
        others: what it is compared with.
        nearness: (D,) inverse depths of the planes, in the world's unit.
    """
    from_pixels = np.linalg.inv(first.to_pixels)
    moves = [_move(first, other) for other in others]

    def warped(plane: np.floating) -> Iterator[FloatArray]:
        for other, (turn, shift) in zip(others, moves, strict=True):
            homography = other.to_pixels @ (turn + np.outer(shift, [0, 0, plane])) @ from_pixels
            yield np.asarray(
                cv2.warpPerspective(
                    other.grey,
                    homography,
                    first.grey.shape[::-1],
                    flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                    borderMode=cv2.BORDER_CONSTANT,
                    borderValue=OUTSIDE,
                ),
                np.float32,
            )

    windows = Windows.of(first.grey)
    return np.stack([_without_worst(windows, warped(plane)) for plane in nearness])


def surface_costs(
    first: Look, others: Sequence[Look], surface: FloatArray, steps: FloatArray
) -> FloatArray:
    """Costs of a view's surface, brought nearer or farther step by step: (K, H, W) in [0, 1].

    Args:
        first: the view.
        others: what it is compared with.
        surface: (H, W) inverse depths.
        steps: (K,) what is added to them.
    """
    height, width = first.grey.shape
    flat = pixel_centres(height, width) - 0.5
    rays = np.concatenate([flat, np.ones((height, width, 1))], axis=-1)
    rays = rays @ np.linalg.inv(first.to_pixels).T
    ways = []
    for other in others:
        turn, shift = _move(first, other)
        far = (rays @ (other.to_pixels @ turn).T).astype(np.float32)
        ways.append((other, far, (other.to_pixels @ shift).astype(np.float32)))

    def warped(step: np.float32) -> Iterator[FloatArray]:
        nearness = surface + step
        for other, far, shift in ways:
            with np.errstate(all="ignore"):
                part = 1 / (far[..., 2] + shift[2] * nearness)
                x = np.where(part > 0, (far[..., 0] + shift[0] * nearness) * part, NOWHERE)
                y = np.where(part > 0, (far[..., 1] + shift[1] * nearness) * part, NOWHERE)
            yield np.asarray(
                cv2.remap(
                    other.grey,
                    x.astype(np.float32),
                    y.astype(np.float32),
                    cv2.INTER_LINEAR,
                    borderMode=cv2.BORDER_CONSTANT,
                    borderValue=OUTSIDE,
                ),
                np.float32,
            )

    windows = Windows.of(first.grey)
    return np.stack([_without_worst(windows, warped(step)) for step in steps])


@dataclass(frozen=True)
class Windows:
    """A picture's windows: their means, and what to multiply by for unit contrast.

    Attributes:
        grey: (H, W).
        mean: (H, W).
        sharpness: (H, W), one over the standard deviation.
    """

    grey: FloatArray
    mean: FloatArray
    sharpness: FloatArray

    @classmethod
    def of(cls, grey: FloatArray) -> Windows:
        """Those around each pixel."""
        mean = _mean(grey)
        variance = np.maximum(_mean(grey * grey) - mean * mean, 0)
        spread = np.asarray(np.sqrt(variance + NOISE), np.float32)
        return cls(grey, mean, np.float32(1) / spread)

    def unlike(self, other: FloatArray) -> FloatArray:
        """(H, W): 0 where windows of another picture correlate fully, 1 where as negatives."""
        there = Windows.of(other)
        alike = _mean(self.grey * other)
        alike -= self.mean * there.mean
        alike *= self.sharpness
        alike *= there.sharpness
        outside = (other < 0).astype(np.uint8)
        unseen = cv2.dilate(outside, np.ones((WINDOW, WINDOW), np.uint8)) > 0
        return np.where(unseen, np.float32(UNSEEN), (1 - alike) / 2).astype(np.float32)


def _without_worst(windows: Windows, pictures: Iterator[FloatArray]) -> FloatArray:
    """The mean cost of all but the worst picture: one may have something in between."""
    costs = [windows.unlike(picture) for picture in pictures]
    if len(costs) == 1:
        return costs[0]
    worst, total = costs[0], costs[0]
    for cost in costs[1:]:
        worst, total = np.maximum(worst, cost), total + cost
    return (total - worst) / np.float32(len(costs) - 1)


def _mean(grey: FloatArray) -> FloatArray:
    size = (WINDOW, WINDOW)
    return np.asarray(cv2.boxFilter(grey, -1, size, borderType=cv2.BORDER_REFLECT_101), np.float32)


def _move(first: Look, other: Look) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """From the first camera's frame to the other's: (3, 3) rotation, (3,) translation."""
    move = other.camera.extrinsics @ np.linalg.inv(first.camera.extrinsics)
    return move[:3, :3], move[:3, 3]
