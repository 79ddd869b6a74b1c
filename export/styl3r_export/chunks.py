"""Chunks of posed videos (RE10K, DL3DV): torch files of JPEG frames and cameras, read as data."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from styl3r_cli.errors import InputError
from styl3r_export.safe_pickle import read_checkpoint

SUFFIX = ".torch"
# Which chunk holds which video; written beside them by the scripts that make them.
INDEX = "index.json"
# A frame's camera: fx fy cx cy (normalised by width and height), two zeros, and the first three
# rows of the world-to-camera matrix.
CAMERA_NUMBERS = 18

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Video:
    """One video of a chunk.

    Attributes:
        key: its name.
        frames: N encoded pictures, uint8 each.
        cameras: (N, 18), see CAMERA_NUMBERS.
    """

    key: str
    frames: list[Tensor]
    cameras: Array

    def __len__(self) -> int:
        return len(self.frames)

    def frame(self, index: int) -> Image.Image:
        """A decoded frame, RGB.

        Raises:
            InputError: it cannot be decoded.
        """
        try:
            with Image.open(io.BytesIO(self.frames[index].numpy().tobytes())) as file:
                return file.convert("RGB")
        except (OSError, ValueError, Image.DecompressionBombError) as error:
            raise InputError(f"video {self.key}: frame {index} is damaged: {error}") from error

    def size(self, index: int) -> tuple[int, int]:
        """(width, height) of a frame, from its header alone."""
        with Image.open(io.BytesIO(self.frames[index].numpy().tobytes())) as file:
            return file.size

    @property
    def extrinsics(self) -> Array:
        """(N, 4, 4) world-to-camera."""
        matrices = np.tile(np.eye(4), (len(self), 1, 1))
        matrices[:, :3] = self.cameras[:, 6:].reshape(-1, 3, 4)
        return matrices

    def fact(self, index: int, size: tuple[int, int]) -> dict[str, Any]:
        """A frame's camera in pixels of a frame of this size (width, height), by name."""
        width, height = size
        fx, fy, cx, cy = self.cameras[index, :4]
        lens = {"fx": fx * width, "fy": fy * height, "cx": cx * width, "cy": cy * height}
        return lens | {"width": width, "height": height, "w2c": self.extrinsics[index]}

    def field_of_view(self) -> float:
        """The widest angle across any frame, degrees, along either side."""
        half = 0.5 / self.cameras[:, :2]
        return float(np.degrees(2 * np.arctan(half.max())))


def read_chunk(path: Path) -> list[Video]:
    """All videos of a chunk; nothing in the file is executed.

    Raises:
        InputError: it is no such file.
    """
    content = read_checkpoint(path)
    if not isinstance(content, list):
        raise InputError(f"{path}: not a chunk of videos; it holds no list")
    return [_video(path, number, item) for number, item in enumerate(content)]


def _video(path: Path, number: int, item: object) -> Video:
    fields = item if isinstance(item, Mapping) else {}
    key, frames, cameras = (fields.get(name) for name in ("key", "images", "cameras"))
    if not (isinstance(key, str) and isinstance(frames, list) and isinstance(cameras, Tensor)):
        raise InputError(f"{path}: item {number} has no 'key', 'images' and 'cameras'")
    if tuple(cameras.shape) != (len(frames), CAMERA_NUMBERS):
        raise InputError(
            f"{path}: video {key} has cameras {tuple(cameras.shape)} for {len(frames)} frames; "
            f"{CAMERA_NUMBERS} numbers a frame are needed"
        )
    if not all(isinstance(frame, Tensor) for frame in frames):
        raise InputError(f"{path}: video {key} has frames that are no tensors of bytes")
    return Video(key, frames, cameras.double().numpy())


def chunk_paths(folder: Path) -> list[Path]:
    """The chunks of a folder, in order.

    Raises:
        InputError: there is none.
    """
    paths = sorted(folder.glob(f"*{SUFFIX}"))
    if not paths:
        raise InputError(f"{folder}: no chunks of videos in it (*{SUFFIX})")
    return paths


def find_videos(folder: Path) -> dict[str, Path]:
    """Which chunk each video is in: by `index.json`, or by looking into all of them.

    Raises:
        InputError: there are no chunks, or a file is damaged.
    """
    paths = chunk_paths(folder)
    index = folder / INDEX
    if not index.is_file():
        return {video.key: path for path in paths for video in read_chunk(path)}
    try:
        names = json.loads(index.read_text(encoding="utf-8"))
        return {str(key): folder / str(name) for key, name in names.items()}
    except (OSError, ValueError, AttributeError) as error:
        raise InputError(f"{index}: not an index of chunks: {error}") from error
