"""Depth where it is known, beside depths that know no picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.depth_errors import DELTA, relative_errors, scale_to, view_depths
from styl3r_export.evaluate.groups import Group
from styl3r_export.evaluate.records import MODEL, Values

# Rounds of reweighting until a plane's fit stands still, and the error that is as good as none.
FIT_ROUNDS = 30
SMALLEST_ERROR = 1e-4

Depths = Sequence[NDArray[np.float64]]  # one array of P depths for each view


def depth_values(group: Group, means: NDArray[np.float32], cameras: Sequence[Camera]) -> Values:
    """AbsRel and delta < 1.25 of a model and of its baselines.

    "one scale" multiplies all views of the group by one number (median scaling, Zhou et al.
    2017: the medians of true and predicted depths agree), so that views must agree with each
    other; "scale per view" multiplies each view by its own.

    Baselines: `constant` is one depth everywhere; `plane (oracle)` is fitted to the true depths
    that it is then measured by, in each view for itself, which no method that sees only pictures
    can do.

    Args:
        group: the views; something must be known in each.
        means: (N, H, W, 3) predicted point maps.
        cameras: the N predicted cameras, in the point maps' frame.
    """
    truth = [view.truth[1] for view in group.views]
    methods: dict[str, Depths] = {
        MODEL: predicted_depths(group, means, cameras),
        "constant": [np.ones_like(depth) for depth in truth],
        "plane (oracle)": [fit_plane(*view.truth) for view in group.views],
    }
    values: Values = {}
    for method, guess in methods.items():
        both = scale_to(np.concatenate(guess), np.concatenate(truth))
        scales = [scale_to(g, t) for g, t in zip(guess, truth, strict=True)]
        for name, factors in (("one scale", [both] * len(guess)), ("scale per view", scales)):
            errors = [
                relative_errors(g * f, t) for g, f, t in zip(guess, factors, truth, strict=True)
            ]
            values["depth", f"AbsRel, {name}", method] = [mean([e[0] for e in errors])]
            values["depth", f"delta<{DELTA}, {name}", method] = [mean([e[1] for e in errors])]
    return values


def predicted_depths(
    group: Group, means: NDArray[np.float32], cameras: Sequence[Camera]
) -> list[NDArray[np.float64]]:
    """Each view's predicted depth where the true one is known: view z of that pixel's Gaussian."""
    depths = []
    for view, points, camera in zip(group.views, means, cameras, strict=True):
        height, width = points.shape[:2]
        uv, _ = view.truth
        column = (uv[:, 0] * width / view.camera.width).astype(int)
        row = (uv[:, 1] * height / view.camera.height).astype(int)
        depths.append(view_depths(points[row, column], camera))
    return depths


def fit_plane(uv: NDArray[np.float64], depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """The depths at `uv` of the surface whose log depth is linear in uv and fits best.

    Least absolute errors (by reweighted least squares): what AbsRel asks for, and what distant
    points behind a close surface do not pull away.
    """
    columns = np.column_stack([uv, np.ones(len(uv))])
    target, weights = np.log(depth), np.ones(len(uv))
    for _ in range(FIT_ROUNDS):
        root = np.sqrt(weights)
        solution = np.linalg.lstsq(columns * root[:, None], target * root, rcond=None)[0]
        weights = 1 / np.maximum(np.abs(columns @ solution - target), SMALLEST_ERROR)
    return np.exp(columns @ solution)


def mean(values: Sequence[float]) -> float:
    """The mean over the views, each of which counts the same."""
    return float(np.mean(values))
