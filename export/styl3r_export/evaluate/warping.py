"""Moving a picture along optical flow: softmax splatting (Niklaus and Liu, CVPR 2020)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

# How strongly a pixel that looks wrong at its goal gives way to others there (their section 3.3).
IMPORTANCE = 20.0

Picture = NDArray[np.floating]
Array = NDArray[np.float64]


def brightness_importance(a: Picture, b: Picture, flow: NDArray[np.float32]) -> Array:
    """(H, W): how much a's pixels count where several land on one, by how well b agrees."""
    height, width = flow.shape[:2]
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    there = cv2.remap(
        b.astype(np.float32), x + flow[..., 0], y + flow[..., 1], cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    return -IMPORTANCE * np.abs(a - there).mean(axis=-1)


def splat(picture: Picture, flow: NDArray[np.float32], importance: Array) -> tuple[Array, Array]:
    """Move every pixel along its flow.

    Args:
        picture: (H, W, C).
        flow: (H, W, 2), x and y in pixels.
        importance: (H, W), the logarithm of a pixel's weight among those that meet.

    Returns:
        The moved picture (H, W, C), and (H, W) how much of each pixel is covered (about 1 where
        the flow neither stretches nor folds, 0 where nothing came).
    """
    height, width = flow.shape[:2]
    y, x = np.mgrid[0:height, 0:width]
    goal_x, goal_y = (x + flow[..., 0]).ravel(), (y + flow[..., 1]).ravel()
    left, top = np.floor(goal_x).astype(int), np.floor(goal_y).astype(int)
    weight = np.exp(importance).ravel()
    layers = np.column_stack([weight[:, None] * picture.reshape(height * width, -1), weight])
    total, cover = np.zeros((height * width, layers.shape[1])), np.zeros(height * width)
    for column, row in ((left, top), (left + 1, top), (left, top + 1), (left + 1, top + 1)):
        share = (1 - np.abs(goal_x - column)) * (1 - np.abs(goal_y - row))
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        cell, share = (row * width + column)[inside], share[inside]
        for layer in range(layers.shape[1]):
            total[:, layer] += np.bincount(cell, share * layers[inside, layer], height * width)
        cover += np.bincount(cell, share, height * width)
    moved = np.divide(
        total[:, :-1], total[:, -1:], out=np.zeros_like(total[:, :-1]), where=total[:, -1:] > 0
    )
    return moved.reshape(height, width, -1), cover.reshape(height, width)
