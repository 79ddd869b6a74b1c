"""Colours in which a scene's views show given pictures best."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.fitting.refit import Target, refit
from styl3r_cli.fitting.tracing import Trace, look
from styl3r_cli.gaussians import FloatArray, Gaussians

# Steps of the colours' least squares. On real pairs the third still sharpens pictures from new
# cameras, the fourth and fifth only those from the views' own.
FIT_STEPS = 3


class ViewsFit:
    """The views' frames as matrices that take colours to pixels.

    Attributes:
        traced: the cameras of the views that were found, and what they see.
    """

    def __init__(
        self,
        plain: Gaussians,
        recovered: Recovered,
        own: FloatArray,
        visible: NDArray[np.bool_],
        threads: int | None,
    ) -> None:
        """Trace the views.

        Args:
            plain: the scene in any colours.
            recovered: the views' cameras.
            own: (N, H, W), how much of each pixel no other view paints.
            visible: (N, H, W), whether its Gaussian is; where it is not, others are in the wrong
                place for the view.
            threads: None for every core.
        """
        self.views = np.flatnonzero(recovered.recovered)
        self.plain, self.threads = plain.colours, threads
        self.own, self.visible = own, visible
        cameras = [recovered.cameras[view] for view in self.views]
        self.traces = look(plain, cameras, threads)
        self.traced = list(zip(cameras, self.traces, strict=True))

    def apply(self, gaussians: Gaussians, pictures: FloatArray, strength: float) -> Gaussians:
        """The Gaussians in the colours that show the pictures (N, H, W, 3) best.

        What another view painted is to be seen as it painted it, in its place: where depths are a
        little wrong, two views' wishes for one stroke would make a blur of it. Of photos' own
        colours, which do not need to be crisp but right, all views' have a say.
        """
        traces = [each.recoloured(gaussians.colours - self.plain) for each in self.traces]
        weights = (1 - np.float32(strength) * (1 - self.own)) * self.visible
        wanted = [(pictures[k].reshape(-1, 3), weights[k].reshape(-1, 1)) for k in self.views]
        return fitted(gaussians, traces, wanted, self.threads)


def fitted(
    gaussians: Gaussians,
    traces: Sequence[Trace],
    wanted: Sequence[tuple[FloatArray, FloatArray]],
    threads: int | None,
) -> Gaussians:
    """The Gaussians in the colours that show pictures (P, 3) of weights (P, 1) best."""
    # What the scene does not cover stays uncovered.
    targets = [
        Target(picture * (1 - each.through[:, None]), each.through, weight)
        for (picture, weight), each in zip(wanted, traces, strict=True)
    ]
    colours = refit(traces, targets, gaussians.colours, FIT_STEPS, threads)
    return gaussians.with_colours(colours)
