"""What a model says about a group of photos: through the same pipeline, graphs or checkpoint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, cast

import numpy as np
import torch

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.gaussians import FloatArray
from styl3r_cli.graphs import Model
from styl3r_cli.locate import locate_views
from styl3r_cli.photos.focal import ASSUMED_FOCAL, focal_from_equivalent
from styl3r_cli.photos.load import Photos
from styl3r_cli.photos.views import FocalSource
from styl3r_cli.pipeline import Scene, Stylizer
from styl3r_cli.sessions import Graph
from styl3r_export.checkpoints import load_any
from styl3r_export.evaluate.groups import Group
from styl3r_export.evaluate.scenes import TrueView
from styl3r_export.graphs_metadata import PAINTING_RANGE, PHOTO_AS_STYLE_RANGES
from styl3r_export.model import Styl3r

Intrinsics = Literal["true", "assumed"]
# What checkpoints are told apart from model folders by.
CHECKPOINTS = (".pt", ".pth", ".ckpt")


@dataclass(frozen=True)
class Prediction:
    """A group's structure, and the cameras that the tool recovers from it."""

    scene: Scene
    recovered: Recovered
    given: list[Camera]  # identity extrinsics; the intrinsics that the network was given


class TorchGraph:
    """One branch of a network in PyTorch, called like a graph in onnxruntime."""

    def __init__(self, model: Styl3r, branch: Literal["structure", "appearance"]) -> None:
        self.model = model
        self.branch = branch

    def __call__(self, feeds: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Run the branch."""
        tensors = {
            name: torch.from_numpy(np.ascontiguousarray(array, np.float32))
            for name, array in feeds.items()
        }
        with torch.inference_mode():
            if self.branch == "appearance":
                return {"colours": self.model.appearance(**tensors).numpy()}
            return {k: v.numpy() for k, v in self.model.structure(**tensors)._asdict().items()}


def load_stylizer(path: Path, threads: int) -> Stylizer:
    """A model folder, a bundled model's name, or a training checkpoint, ready to be asked.

    Raises:
        InputError: a checkpoint is no such file.
        ModelError: a folder holds no model.
    """
    if path.suffix not in CHECKPOINTS:
        return Stylizer(str(path), "cpu", threads)
    network = load_any(path).eval()
    model = Model(
        name=network.config.name,
        folder=path,
        structure=cast(Graph, TorchGraph(network, "structure")),
        appearance=cast(Graph, TorchGraph(network, "appearance")),
        style_range=PAINTING_RANGE,
        content_range=PHOTO_AS_STYLE_RANGES[network.config.photo_as_style],
        paints_pictures=network.config.colours == "strokes",
        input_size=(256, 256),
        device="cpu",
    )
    return Stylizer(model)


def predict(stylizer: Stylizer, group: Group, intrinsics: Intrinsics) -> Prediction:
    """Run the structure branch and recover the cameras, as `styl3r stylize` does.

    Args:
        stylizer: the model.
        group: the photos.
        intrinsics: whether the network is given the true intrinsics (as from a camera file), or
            ones that are assumed (as for photos without EXIF data).
    """
    given = [given_camera(view, intrinsics) for view in group.views]
    photos = as_photos(group, given, intrinsics)
    scene = stylizer.encode(photos)
    return Prediction(*locate_views(scene, photos, 1), given)


def given_camera(view: TrueView, intrinsics: Intrinsics) -> Camera:
    """What the network is told of a view."""
    if intrinsics == "true":
        return replace(view.camera, extrinsics=np.eye(4))
    size, focal = view.camera.width, assumed_focal(view)
    return Camera(np.eye(4), focal, focal, size / 2, size / 2, size, size)


def assumed_focal(view: TrueView) -> float:
    """Pixels of the crop: what the tool assumes for a photo that says nothing."""
    focal = focal_from_equivalent(ASSUMED_FOCAL, *view.photo_size)
    return focal * view.camera.width / min(view.photo_size)


def as_photos(group: Group, given: list[Camera], intrinsics: Intrinsics) -> Photos:
    """A group as the tool would have loaded it."""
    views = group.views
    source: FocalSource = "cameras" if intrinsics == "true" else "assumed"
    normalised = [c.intrinsics / np.array([[c.width], [c.height], [1.0]]) for c in given]
    return Photos(
        images=np.stack([view.image for view in views]),
        intrinsics=np.stack(normalised).astype(np.float32),
        names=[view.name for view in views],
        paths=[Path(view.name) for view in views],
        sizes=[view.photo_size for view in views],
        focal_sources=[source] * len(views),
        notes=[],
        details=[view.finest for view in views],
    )
