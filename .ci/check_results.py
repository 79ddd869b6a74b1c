"""What the main job wrote, read by a program that was not there: scene, contact sheet, video."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

import av
import numpy as np
from PIL import Image

from styl3r_cli.formats import read_scene

FEWEST_GAUSSIANS = 60_000  # of the 262,144 pixels of four photos, a third show all to 45 dB
LEAST_CONTRAST = 5.0  # standard deviation in 8-bit steps; an empty picture has none
LEAST_MOTION = 0.5  # mean difference of two frames in 8-bit steps


def check(condition: bool, message: str) -> None:
    """End with one line if something is wrong."""
    if not condition:
        sys.exit(f"check_results: {message}")


def main(scene: Path, sheet: Path, video: Path) -> None:
    """Check the three files."""
    check(find_spec("torch") is None, "torch came with the main job, which needs none")
    gaussians = read_scene(scene).gaussians
    check(len(gaussians) > FEWEST_GAUSSIANS, f"{scene} has only {len(gaussians)} Gaussians")
    picture = np.asarray(Image.open(sheet).convert("RGB"))
    check(picture.std() > LEAST_CONTRAST, f"{sheet} is empty")
    with av.open(str(video)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    check(len(frames) > 1, f"{video} does not move")
    check(all(frame.std() > LEAST_CONTRAST for frame in frames), f"{video} has empty frames")
    motion = np.abs(frames[len(frames) // 2].astype(float) - frames[0]).mean()
    check(motion > LEAST_MOTION, f"{video} does not move")
    print(f"{len(gaussians):,} Gaussians, a sheet of {picture.shape[1]}x{picture.shape[0]} pixels,")
    print(f"{len(frames)} frames of {frames[0].shape[1]}x{frames[0].shape[0]} pixels")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
