"""LPIPS v0.1 with AlexNet (Zhang et al., CVPR 2018), from a plain .npz of its weights.

As a command it writes the graph that `styl3r tradeoff --lpips` reads.
"""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

import click
import numpy as np
import onnx_ir as ir
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.export import Dim
from torch.nn import functional as F

from styl3r_cli.errors import InputError, ModelError, Styl3rError, shortened
from styl3r_cli.files import atomic_write
from styl3r_cli.tradeoff.perceptual import INPUTS, LEAST_SIDE, OUTPUTS, Perceptual
from styl3r_export.curriculum.teachers import load_npz
from styl3r_export.graph_passes import simplify
from styl3r_export.onnx_export import trace
from styl3r_export.verify import TOLERANCE

SHIFT = (-0.030, -0.088, -0.188)  # of pictures in [-1, 1] (published)
SCALE = (0.458, 0.448, 0.450)
# Convolutions of torchvision's AlexNet: name, stride, padding, and a maximum before it or not.
LAYERS = ((0, 4, 2, False), (3, 1, 2, True), (6, 1, 1, True), (8, 1, 1, False), (10, 1, 1, False))
EPS = 1e-10  # keeps the direction of a zero feature finite (published)
NAMES = {
    *(f"features.{layer}.{part}" for layer, *_ in LAYERS for part in ("weight", "bias")),
    *(f"lin{level}.weight" for level in range(len(LAYERS))),
}
MOST_SIDE = 4096  # that the tracer is told of
TRACED = (48, 65)  # height and width that the trace sees
CHECKED = ((LEAST_SIDE, 40), (64, 64), (131, 90), (256, 256))  # and those it is verified with

HELP = """\
Write LPIPS (AlexNet) as the graph that `styl3r tradeoff --lpips` reads, and verify it.

WEIGHTS is an .npz of the linear layers and of torchvision's AlexNet. Where the packages lpips and
torchvision are installed, this makes it:

\b
  import lpips, numpy
  net = lpips.LPIPS(net="alex").state_dict()
  named = {k.split(".", 2)[2]: v for k, v in net.items() if k.startswith("net.slice")}
  numpy.savez("alex.npz", **{f"features.{k}": v for k, v in named.items()},
              **{f"lin{i}.weight": net[f"lin{i}.model.1.weight"] for i in range(5)})
"""


class Lpips:
    """Perceptual distance of two pictures; 0 for equal ones."""

    def __init__(self, weights: Path) -> None:
        """Read AlexNet's convolutions (`features.N...`) and the linear layers (`linK.weight`).

        Raises:
            FileNotFoundError: there is no such file.
            InputError: it has no such weights.
        """
        try:
            self.weights = load_npz(weights)
        except (TypeError, ValueError, zipfile.BadZipFile) as error:
            raise InputError(f"{weights}: not an .npz file: {shortened(str(error))}") from error
        if missing := sorted(NAMES - set(self.weights)):
            raise InputError(f"{weights}: no weights of LPIPS with AlexNet: no {missing[0]}")
        self.shift, self.scale = (torch.tensor(v).view(1, 3, 1, 1) for v in (SHIFT, SCALE))

    def __call__(self, a: NDArray[np.floating], b: NDArray[np.floating]) -> float:
        """The distance of pictures (H, W, 3) in [0, 1] (clipped to it)."""
        pair = np.stack([a, b]).clip(0, 1).transpose(0, 3, 1, 2).astype(np.float32)
        with torch.inference_mode():
            return float(self.distance(torch.from_numpy(np.ascontiguousarray(pair))))

    def distance(self, pair: Tensor) -> Tensor:
        """The distance of the two pictures of a batch (2, 3, H, W) in [0, 1]."""
        total = torch.zeros(())
        for level, features in enumerate(self.features(pair)):
            unit = features / (features.square().sum(dim=1, keepdim=True).sqrt() + EPS)
            difference = (unit[0] - unit[1]).square().mean(dim=(1, 2))
            total = total + (difference * self.weights[f"lin{level}.weight"].flatten()).sum()
        return total

    def features(self, pictures: Tensor) -> list[Tensor]:
        """Five depths of AlexNet."""
        x = (pictures * 2 - 1 - self.shift) / self.scale
        depths = []
        for layer, stride, padding, pooled in LAYERS:
            if pooled:
                x = F.max_pool2d(x, 3, 2)
            weight, bias = (self.weights[f"features.{layer}.{n}"] for n in ("weight", "bias"))
            x = F.relu(F.conv2d(x, weight, bias, stride, padding))
            depths.append(x)
        return depths


class LpipsGraph(nn.Module):
    """The distance as a module of two pictures, for the tracer."""

    def __init__(self, lpips: Lpips) -> None:
        super().__init__()
        self.lpips = lpips

    def forward(
        self, image: Float[Tensor, "1 3 H W"], reference: Float[Tensor, "1 3 H W"]
    ) -> Float[Tensor, " 1"]:
        """Of pictures in [0, 1]."""
        return self.lpips.distance(torch.cat([image, reference])).reshape(1)


def export(weights: Path, output: Path) -> float:
    """Write the graph of some weights, once onnxruntime agrees with torch.

    Returns:
        The largest relative difference of both, over pictures of several sizes.

    Raises:
        InputError: there are no such weights in the file.
        ModelError: onnxruntime gives something else than torch.
        OutputError: the graph cannot be written.
    """
    lpips = Lpips(weights)
    pictures = {name: torch.rand(1, 3, *TRACED) for name in INPUTS}
    height, width = (Dim(side, min=LEAST_SIDE, max=MOST_SIDE) for side in ("height", "width"))
    sides = {2: height, 3: width}
    graph = trace(LpipsGraph(lpips), pictures, dict.fromkeys(INPUTS, sides), list(OUTPUTS))
    simplify(graph, set())
    with atomic_write(output) as temporary:
        ir.save(graph, temporary)
        off = verify(temporary, lpips)
        if not off <= TOLERANCE:
            raise ModelError(f"onnxruntime differs from torch by {off:.1e}; nothing written")
    return off


def verify(path: Path, lpips: Lpips) -> float:
    """The largest relative difference of a graph's distances from torch's."""
    random, worst = np.random.default_rng(0), 0.0
    for height, width in CHECKED:
        graph = Perceptual(path, (width, height))
        a, b = random.random((2, height, width, 3), np.float32)
        truth = lpips(a, b)
        worst = max(worst, abs(graph(a, b) - truth) / truth)
    return worst


@click.command(help=HELP)
@click.argument("weights", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--output", "-o", required=True, type=click.Path(path_type=Path), metavar="NET.onnx")
def main(weights: Path, output: Path) -> None:
    """Export, and say how well both agree."""
    try:
        off = export(weights, output)
    except Styl3rError as error:
        print(f"Error: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    print(f"{output}: {output.stat().st_size / 1e6:.1f} MB, {off:.1e} from torch at most")


if __name__ == "__main__":
    main()
