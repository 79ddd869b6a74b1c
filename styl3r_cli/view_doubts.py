"""Views that a user should look at: of another place, or nowhere to be seen."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

# Opacity, a part of the clearest view's, below which nobody notices a view.
HARDLY_SEEN = 0.1


def doubts(opacities: NDArray[np.floating], matched: Collection[int]) -> dict[int, str]:
    """A line each on views that hardly fit the others, by their indices.

    Args:
        opacities: (N, H, W) of the scene's Gaussians.
        matched: the views that share enough features with another one.
    """
    notes: dict[int, str] = {}
    middles = np.median(np.nan_to_num(opacities), axis=(1, 2))
    for view, middle in enumerate(middles):
        if middle < HARDLY_SEEN * middles.max():
            notes[view] = (
                f"view {view + 1}: hardly visible: it fits the others badly, or they show all of it"
            )
        # Where no views share features, there is nothing to compare this one with.
        if matched and view not in matched:
            notes[view] = (
                f"view {view + 1}: shares hardly any features with the others; is it of the same "
                "place?"
            )
    return notes
