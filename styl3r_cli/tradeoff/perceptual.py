"""LPIPS by a graph that the user has: its network's weights do not come with styl3r."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from styl3r_cli.errors import ModelError, UsageError
from styl3r_cli.gaussians import FloatArray
from styl3r_cli.sessions import Graph

# Names and ranks, all float32: two pictures (1, 3, H, W), sRGB in [0, 1], and their distance (1,).
INPUTS = {"image": 4, "reference": 4}
OUTPUTS = {"distance": 1}
# Pixels that AlexNet's poolings leave something of; onnxruntime ends the process over nothing.
LEAST_SIDE = 31
# What equal pictures may be apart: features in half precision round by less.
NOTHING = 1e-3


class Perceptual:
    """The perceptual distance of two pictures; 0 for equal ones."""

    def __init__(self, path: Path, size: tuple[int, int], threads: int | None = None) -> None:
        """Load a graph, as `python -m styl3r_export.evaluate.lpips` writes it, and try it.

        Args:
            path: the .onnx file.
            size: (width, height) of pictures that it will get.
            threads: None for every core.

        Raises:
            ModelError: it cannot be loaded, has another signature, does not take such pictures,
                or measures no distance.
            UsageError: such pictures are too small.
        """
        width, height = size
        if min(size) < LEAST_SIDE:
            raise UsageError(
                f"--lpips: pictures of {width}x{height}; it takes {LEAST_SIDE} pixels or more"
            )
        self._graph = Graph.load(path, "cpu", threads)
        self._graph.check(INPUTS, {}, OUTPUTS)
        grey = np.full((height, width, 3), 0.5, np.float32)
        apart = self(grey, grey)
        if not abs(apart) <= NOTHING:
            raise ModelError(f"{path}: no distance: it is {apart:g} for equal pictures")

    def __call__(self, image: FloatArray, reference: FloatArray) -> float:
        """The distance of two pictures (H, W, 3), sRGB in [0, 1].

        Raises:
            ModelError: the graph failed, or gave more than one number.
        """
        pictures = (each.transpose(2, 0, 1)[None] for each in (image, reference))
        distance = self._graph(dict(zip(INPUTS, pictures, strict=True)))["distance"]
        if distance.size != 1:
            raise ModelError(f"{self._graph.path}: {distance.size} distances of two pictures")
        return float(distance.item())
