"""One way to run a network, in a process of its own that answers each request with its times."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from styl3r_cli.gaussians import FloatArray
from styl3r_cli.limits import available_cores
from styl3r_cli.photos import Photos, load_photos, load_style
from styl3r_cli.pipeline import Scene, Stylizer
from styl3r_cli.tradeoff.worker import peak_memory

TORCH = "torch"  # instead of a model folder: the network that the checkpoint holds, in torch


class Network(Protocol):
    """What a `Stylizer` does, whatever does the arithmetic."""

    def encode(self, photos: Photos) -> Scene:
        """Geometry and content tokens."""
        ...

    def colours(self, scene: Scene, styles: list[FloatArray]) -> FloatArray:
        """Colours (N, H, W, 3) in equal shares of the styles."""
        ...


class TorchNetwork:
    """The network in torch: float32, eager, every core."""

    def __init__(self, checkpoint: str) -> None:
        import torch

        from styl3r_cli.commands.export import read_model

        torch.set_num_threads(available_cores())
        self.torch = torch
        self.model = read_model(checkpoint)[0].requires_grad_(False)

    def encode(self, photos: Photos) -> Scene:
        """Geometry and content tokens."""
        images, intrinsics = (
            self.torch.from_numpy(array) for array in (photos.images, photos.intrinsics)
        )
        with self.torch.inference_mode():
            out = self.model.structure(images, intrinsics)
        return Scene(photos.images, photos.intrinsics, *(value.numpy() for value in out))

    def colours(self, scene: Scene, styles: list[FloatArray]) -> FloatArray:
        """Colours in equal shares of the styles."""
        tokens, images = (self.torch.from_numpy(a) for a in (scene.content_tokens, scene.images))
        weights = self.torch.full((len(styles),), 1 / len(styles))
        with self.torch.inference_mode():
            pictures = self.torch.from_numpy(np.stack(styles))
            colours: FloatArray = self.model.appearance(tokens, pictures, weights, images).numpy()
        return colours


def serve(kind: str, checkpoint: str, photos: list[str], styles: list[str]) -> None:
    """Load, then answer: `run` with seconds and memory, a path by saving the last scene to it."""
    views = load_photos([Path(name) for name in photos])
    paintings = [load_style(Path(name)).image for name in styles]
    start = time.perf_counter()
    network: Network = TorchNetwork(checkpoint) if kind == TORCH else Stylizer(kind, "cpu")
    _tell({"load": time.perf_counter() - start})
    scene, colours = None, None
    for line in sys.stdin:
        request = line.strip()
        if request == "run":
            scene, colours = None, None  # an earlier run's arrays would count twice
            processor, start = time.process_time(), time.perf_counter()
            scene = network.encode(views)
            between = time.perf_counter()
            colours = network.colours(scene, paintings)
            end = time.perf_counter()
            _tell(
                {
                    "structure": between - start,
                    "appearance": end - between,
                    "processor": time.process_time() - processor,
                    "memory": peak_memory(),
                }
            )
        else:
            assert scene is not None
            assert colours is not None
            np.savez(request, colours=colours, **vars(scene))
            _tell({})


def _tell(result: dict[str, Any]) -> None:
    print(json.dumps(result), flush=True)


if __name__ == "__main__":
    serve(**json.loads(sys.argv[1]))
