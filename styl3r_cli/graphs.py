"""A model: a folder with two ONNX graphs, found by name, verified and loaded."""

from __future__ import annotations

import json
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

from styl3r_cli import limits, needs
from styl3r_cli import manifest as manifests
from styl3r_cli.errors import ModelError, shortened
from styl3r_cli.manifest import Manifest
from styl3r_cli.names import user_path
from styl3r_cli.photos.resize import PATCH
from styl3r_cli.sessions import Graph

BUNDLED = Path(__file__).parent / "models"  # each folder in it is a model of that name

# Names and ranks, all float32 (batch-free: N views, S styles).
STRUCTURE_INPUTS = {"images": 4, "intrinsics": 3}
STRUCTURE_OUTPUTS = {
    "means": 4,
    "scales": 4,
    "rotations": 4,
    "opacities": 3,
    "content_tokens": 3,
}
APPEARANCE_INPUTS = {"style_images": 4, "style_weights": 1}
APPEARANCE_OPTIONAL = {"content_tokens": 3, "images": 4}  # fed to the models that declare them
APPEARANCE_OUTPUTS = {"colours": 4}

# Optimising a structure graph pays within its first run where the arithmetic takes long, and not
# in a small one: for mini and two views it costs 0.4 s of processor time and saves 0.1 s.
SMALL_GRAPH = 64_000_000  # bytes
_LARGEST = 1e6  # of a picture's sides, and of what its values are scaled to
UNFUSED = ("fp32", "fp16")  # precisions that run well unoptimised; integer operators must be fused


@dataclass(frozen=True)
class Model:
    """Both graphs of a model, and how it reads its pictures.

    Attributes:
        name: "mini", "full", ...
        folder: where it lies.
        structure: images, intrinsics to geometry and content tokens.
        appearance: content tokens and styles to colours.
        style_range: lowest and highest value of a painting, as the style encoder reads it.
        content_range: the same for a content photo standing in for a painting.
        paints_pictures: whether its colours are what the views should look like, made without
            regard to how Gaussians blur; else they were trained through a renderer.
        input_size: (height, width) that it was trained at.
        device: "cpu" or "cuda", where it runs.
    """

    name: str
    folder: Path
    structure: Graph
    appearance: Graph
    style_range: tuple[float, float]
    content_range: tuple[float, float]
    paints_pictures: bool
    input_size: tuple[int, int]
    device: str

    @classmethod
    def load(
        cls,
        model: str = "mini",
        device: str = "auto",
        threads: int | None = None,
        one_scene: bool = False,
    ) -> Model:
        """Verify and load both graphs, at the same time.

        Args:
            model: the name of a bundled model, or a folder that `styl3r export` wrote.
            device: one of DEVICES.
            threads: for each graph's run; None for every core this process may use.
            one_scene: that it will encode one scene only, so that loading may count for more.

        Raises:
            ModelError: a file is missing, damaged, or not such a graph.
            OutOfMemoryError: this process may not use as much memory as it takes.
            UsageError: the device or the name does not exist here.
        """
        limits.check(needs.network())
        folder = find(model)
        manifest = manifests.read_manifest(folder)

        def load(name: str) -> Graph:
            size = sum(manifest.files[file].bytes for file in manifests.files_of(name, manifest))
            small = size < SMALL_GRAPH and manifest.precision in UNFUSED
            quick = one_scene and name == manifests.STRUCTURE and small
            return _verified(folder, name, manifest, device, threads, not quick)

        graphs = (manifests.STRUCTURE, manifests.APPEARANCE)
        read = [file for graph in graphs for file in manifests.files_of(graph, manifest)]
        for other in manifest.files.keys() - read:  # weights may lie in files of any name
            manifests.check_file(folder, other, manifest)
        with ThreadPoolExecutor(2) as pool:
            structure, appearance = pool.map(load, graphs)
        structure.check(STRUCTURE_INPUTS, {}, STRUCTURE_OUTPUTS)
        appearance.check(APPEARANCE_INPUTS, APPEARANCE_OPTIONAL, APPEARANCE_OUTPUTS)
        return cls(
            name=manifest.model,
            folder=folder,
            structure=structure,
            appearance=appearance,
            style_range=_pair(appearance, manifests.PROP_PAINTING_RANGE, (0.0, 1.0)),
            content_range=_pair(appearance, manifests.PROP_PHOTO_RANGE, (-1.0, 1.0)),
            paints_pictures=appearance.metadata.get(manifests.PROP_PICTURES) == "true",
            input_size=_size(structure),
            device=structure.device,
        )


def find(model: str) -> Path:
    """The folder of a bundled model's name, or the folder itself.

    Raises:
        ModelError: there is neither.
    """
    bundled = BUNDLED / model
    if os.sep not in model and (bundled / manifests.MANIFEST).is_file():
        return bundled
    folder = user_path(model)
    if not folder.is_dir():
        names = sorted(path.parent.name for path in BUNDLED.glob(f"*/{manifests.MANIFEST}"))
        known = ", ".join(names) or "none"
        raise ModelError(f"no model '{model}': neither bundled ({known}) nor a folder")
    return folder


def _verified(
    folder: Path,
    name: str,
    manifest: Manifest,
    device: str,
    threads: int | None,
    optimise: bool,
) -> Graph:
    for file in manifests.files_of(name, manifest):
        manifests.check_file(folder, file, manifest)
    graph = Graph.load(folder / name, device, threads, optimise)
    if graph.metadata.get(manifests.PROP_WEIGHTS_ID) != manifest.weights_id:
        raise ModelError(f"{graph.path}: does not belong to this manifest; export the model again")
    return graph


def _pair(graph: Graph, key: str, default: tuple[float, float]) -> tuple[float, float]:
    """Two numbers from a graph's metadata: a range of values, or a size."""
    text = graph.metadata.get(key)
    if text is None:
        return default
    try:
        first, second = (float(number) for number in json.loads(text))
        if not max(abs(first), abs(second)) <= _LARGEST or not isfinite(first + second):
            raise ValueError("no values of a picture, and no size of one")
        return first, second
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        message = f"{graph.path}: metadata {key} is '{shortened(text)}', not two numbers"
        raise ModelError(message) from error


def _size(graph: Graph) -> tuple[int, int]:
    """(height, width) that a model was trained at.

    Raises:
        ModelError: it is no size that a network of patches reads.
    """
    size = _pair(graph, manifests.PROP_INPUT_SIZE, (256, 256))
    if any(side < PATCH or side % PATCH for side in size):
        message = f"{graph.path}: metadata {manifests.PROP_INPUT_SIZE} is {size}"
        raise ModelError(f"{message}, not multiples of {PATCH}")
    return int(size[0]), int(size[1])
