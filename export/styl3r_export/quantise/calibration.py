"""Photos and styles that precisions are calibrated on and compared with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from styl3r_cli.gaussians import FloatArray
from styl3r_cli.graphs import Model
from styl3r_cli.manifest import APPEARANCE, STRUCTURE
from styl3r_cli.photos import Photos
from styl3r_cli.pipeline import Stylizer
from styl3r_cli.sessions import Graph

# A made-up scene, for those who give no photos: a wall of smooth patches in several sizes, seen
# from two places. It is for comparing pictures, not for calibration.
OCTAVES = (4, 16, 64)
SHIFT = 16  # pixels between its two views
SIDE = 256
SEED = 0


@dataclass(frozen=True)
class Sample:
    """Photos of one scene, and the style pictures (3, h, w) that it is coloured with.

    Without styles, its own colours are used.
    """

    name: str
    photos: Photos
    styles: list[FloatArray]


def made_up() -> Sample:
    """The made-up scene in its own colours."""
    from PIL import Image

    random = np.random.default_rng(SEED)
    wall = np.zeros((SIDE, SIDE + SHIFT, 3))
    for nodes in OCTAVES:
        coarse = Image.fromarray(random.integers(0, 256, (nodes, nodes, 3), dtype=np.uint8))
        wall += np.asarray(coarse.resize((SIDE + SHIFT, SIDE), Image.Resampling.BICUBIC)) / 255
    views = np.stack([wall[:, :SIDE], wall[:, SHIFT:]]) / len(OCTAVES)
    images = np.ascontiguousarray(views.transpose(0, 3, 1, 2).astype(np.float32))
    lens = np.array([[0.9, 0, 0.5], [0, 0.9, 0.5], [0, 0, 1]], np.float32)
    names = [Path("left"), Path("right")]
    photos = Photos(
        images=images,
        intrinsics=np.stack([lens, lens]),
        names=[name.name for name in names],
        paths=names,
        sizes=[(SIDE, SIDE)] * 2,
        focal_sources=["fov", "fov"],
        notes=[],
    )
    return Sample("a made-up wall", photos, [])


def feeds_of(folder: Path, samples: Sequence[Sample]) -> dict[str, list[dict[str, FloatArray]]]:
    """What the graphs of a model are fed for some samples, by the graph's file name."""
    model = Model.load(str(folder), "cpu")
    recorders = {STRUCTURE: _Recorder(model.structure), APPEARANCE: _Recorder(model.appearance)}
    recorded = replace(
        model,
        structure=recorders[STRUCTURE],  # type: ignore[arg-type]
        appearance=recorders[APPEARANCE],  # type: ignore[arg-type]
    )
    stylizer = Stylizer(recorded)
    for sample in samples:
        colour(stylizer, sample)
    return {name: recorder.feeds for name, recorder in recorders.items()}


def colour(stylizer: Stylizer, sample: Sample) -> None:
    """Run both graphs once."""
    scene = stylizer.encode(sample.photos)
    stylizer.colours(scene, sample.styles, strength=1.0 if sample.styles else 0.0)


class _Recorder:
    """A graph that remembers what it was fed."""

    def __init__(self, graph: Graph) -> None:
        self.feeds: list[dict[str, FloatArray]] = []
        self._graph = graph

    def __call__(self, feeds: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        self.feeds.append({name: feeds[name] for name in self._graph.inputs if name in feeds})
        return self._graph(feeds)
