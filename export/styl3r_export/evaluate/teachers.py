"""Networks that the evaluation measures with and compares to, from one folder of weights."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from styl3r_cli.errors import InputError
from styl3r_cli.onnx_library import onnxruntime
from styl3r_export.curriculum.perceptual import SlimVgg
from styl3r_export.evaluate.lpips import Lpips
from styl3r_export.evaluate.raft import Raft

LPIPS = "lpips/lpips_alex.npz"
SLIM_VGG = "vgg19-slim16x/encoder_stage5.npz"
RAFT = "raft-small/weights.npz"
MICRO_AST = "micro-ast/microast.onnx"
MAGENTA_PREDICT = "magenta-arbitrary-stylization/style_predict.onnx"
MAGENTA_TRANSFER = "magenta-arbitrary-stylization/style_transfer.onnx"

Picture = NDArray[np.floating]


class Stylizer2d(Protocol):
    """Something that paints a picture (H, W, 3) in the style of another, both in [0, 1]."""

    def __call__(self, content: Picture, style: Picture) -> Picture:
        """The stylized picture, clipped to [0, 1]."""
        ...


@dataclass(frozen=True)
class Teachers:
    """What the folder holds.

    Attributes:
        lpips: the perceptual distance.
        flow: optical flow between pictures.
        vgg: features at four depths, for style and content distances.
        stylizers: stylizers of single pictures, by name.
    """

    lpips: Lpips
    flow: Raft
    vgg: SlimVgg
    stylizers: dict[str, Stylizer2d]

    @classmethod
    def load(cls, folder: Path, threads: int) -> Teachers:
        """Read all of them.

        Raises:
            InputError: a file is missing or damaged.
        """
        try:
            return cls(
                Lpips(folder / LPIPS),
                Raft(folder / RAFT),
                SlimVgg(folder / SLIM_VGG),
                {
                    "MicroAST": MicroAst(folder / MICRO_AST, threads),
                    "Magenta": Magenta(
                        folder / MAGENTA_PREDICT, folder / MAGENTA_TRANSFER, threads
                    ),
                },
            )
        except Exception as error:  # numpy, torch and onnxruntime raise whatever they like
            raise InputError(f"{folder}: not a folder of teachers: {error}") from error


class MicroAst:
    """MicroAST (Wang et al., AAAI 2023)."""

    def __init__(self, graph: Path, threads: int) -> None:
        self.session = _session(graph, threads)

    def __call__(self, content: Picture, style: Picture) -> Picture:
        """The stylized picture, at full strength."""
        feeds = {"content": planes(content), "style": planes(style)}
        feeds["alpha"] = np.ones(1, np.float32)
        return pixels(self.session.run(None, feeds)[0])


class Magenta:
    """Magenta's arbitrary image stylization (Ghiasi et al., BMVC 2017), mobile version."""

    def __init__(self, predict: Path, transfer: Path, threads: int) -> None:
        self.predict = _session(predict, threads)
        self.transfer = _session(transfer, threads)

    def __call__(self, content: Picture, style: Picture) -> Picture:
        """The stylized picture, at full strength."""
        code = self.predict.run(None, {"style_image": planes(style)})[0]
        feeds = {"content_image": planes(content), "style_bottleneck": code}
        return pixels(self.transfer.run(None, feeds)[0])


def _session(graph: Path, threads: int) -> Any:
    ort = onnxruntime()
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3  # errors only
    return ort.InferenceSession(graph, options, providers=["CPUExecutionProvider"])


def planes(picture: Picture) -> NDArray[np.float32]:
    """(H, W, 3) to (1, 3, H, W) float32, clipped to [0, 1]."""
    return np.ascontiguousarray(np.clip(picture, 0, 1).transpose(2, 0, 1)[None], np.float32)


def pixels(batch: NDArray[np.float32]) -> NDArray[np.float32]:
    """(1, 3, H, W) to (H, W, 3), clipped to [0, 1]."""
    return np.clip(batch[0].transpose(1, 2, 0), 0, 1)


def features(vgg: SlimVgg, picture: Picture) -> list[torch.Tensor]:
    """Four depths of the perceptual network."""
    with torch.inference_mode():
        return vgg(torch.from_numpy(planes(picture)))
