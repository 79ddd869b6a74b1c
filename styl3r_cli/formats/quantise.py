"""Rounding to few bits: unit intervals, rotations by their three smallest parts, and the order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

HALF = np.sqrt(0.5)  # no part of a unit quaternion but its largest can be larger
MORTON_BITS = 21  # three of them fit into 64 bits


def to_levels(values: NDArray[np.floating], top: int) -> NDArray[np.uint32]:
    """The nearest of the integers 0..top to values in [0, 1]; values outside are clipped."""
    return np.rint(np.clip(values.astype(np.float64), 0, 1) * top).astype(np.uint32)


def to_bytes(values: NDArray[np.floating]) -> NDArray[np.uint8]:
    """8 bits of values in [0, 1]."""
    return to_levels(values, 255).astype(np.uint8)


def smallest_three(
    quaternions: NDArray[np.float64],
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """What of unit quaternions has to be stored.

    Args:
        quaternions: (G, 4), parts in any order.

    Returns:
        (G,) the index of the largest part, and (G, 3) the others in their order, within
        -HALF..HALF; their signs are those of the quaternion whose largest part is positive.
    """
    rows = np.arange(len(quaternions))
    largest = np.abs(quaternions).argmax(axis=1)
    positive = quaternions * np.where(quaternions[rows, largest] < 0, -1, 1)[:, None]
    return largest, positive[_others(largest)].reshape(-1, 3)


def from_smallest_three(
    largest: NDArray[np.integer], others: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The inverse: (G, 4) unit quaternions (also where the three parts are too long)."""
    quaternions = np.empty((len(others), 4))
    rest = np.sqrt(np.maximum(0, 1 - np.square(others).sum(axis=1)))
    quaternions[np.arange(len(others)), largest] = rest
    quaternions[_others(largest)] = others.ravel()
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def _others(largest: NDArray[np.integer]) -> NDArray[np.bool_]:
    return np.arange(4) != largest[:, None]


def morton_order(means: NDArray[np.float32]) -> NDArray[np.intp]:
    """Indices that sort points along the Z-order curve of their bounding box; ties by index.

    Neighbours in this order are neighbours in space, which makes chunks small and pictures smooth.
    """
    if not len(means):
        return np.zeros(0, np.intp)
    low, high = means.min(axis=0).astype(np.float64), means.max(axis=0).astype(np.float64)
    cells = (means - low) / np.where(high > low, high - low, 1)
    levels = (cells * ((1 << MORTON_BITS) - 1)).astype(np.uint64)
    code = np.zeros(len(means), np.uint64)
    for axis in range(3):
        code |= _spread(levels[:, axis]) << np.uint64(axis)
    return np.argsort(code, kind="stable")


def _spread(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Two zero bits after each of the 21 bits of a number."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        values = (values | values << np.uint64(shift)) & np.uint64(mask)
    return values
