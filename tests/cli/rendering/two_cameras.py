"""Two cameras and what they see, for the tests of `styl3r render`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from styl3r_cli.cameras.camera import Camera

Run = Callable[..., tuple[int, str]]


# What is seen behind a scene in other viewers, and what `render` gives.
BLACK = ("--background", "black")


def camera_at(x: float, width: int = 64, height: int = 48) -> Camera:
    extrinsics = np.eye(4)
    extrinsics[0, 3] = -x
    return Camera(extrinsics, 60.0, 61.0, width / 2 + 1, height / 2 - 2, width, height)


CAMERAS = [camera_at(0.0), camera_at(0.3)]


def video_frames(path: Path) -> list[np.ndarray]:
    import av

    with av.open(str(path)) as container:
        assert container.streams.video[0].codec_context.name == "h264"
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
