"""Whether stylized frames agree with each other as a camera moves (paper, section 4.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras import poses
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.frames import Drawing
from styl3r_cli.gaussians import Gaussians
from styl3r_export.evaluate.records import MODEL, Values
from styl3r_export.evaluate.style import Painting
from styl3r_export.evaluate.teachers import Teachers
from styl3r_export.evaluate.warping import brightness_importance, splat

FRAMES = 60  # from the first input's camera to the last's, as the published code films a scene
# Frames compared, at both ends and in the middle: neighbours, and those that are 7 apart as in the
# paper; besides, the first with the last.
PAIRS = {
    "short": ((0, 1), (29, 30), (58, 59)),
    "long": ((0, 7), (26, 33), (52, 59)),
    "whole": ((0, 59),),
}
# A pixel is compared if this much of it is covered, by Gaussians and by moved pixels: black holes
# agree with each other only too well.
LEAST_COVER = 0.5
LEAST_CONTRAST = 1 / 255  # below it a frame is one colour
OWN = "own colours"
PHOTOS = "the photos"  # first and last input, beside the frames from their cameras

Picture = NDArray[np.floating]


@dataclass(frozen=True)
class Motion:
    """How frame a moves to frame b.

    Attributes:
        flow: (H, W, 2) from a to b.
        importance: (H, W) of a's pixels where several meet.
        valid: (H, W) which of b's pixels can be compared.
    """

    flow: NDArray[np.float32]
    importance: NDArray[np.float64]
    valid: NDArray[np.bool_]


def consistency_values(
    own: Gaussians,
    stylized: Gaussians,
    cameras: Sequence[Camera],
    painting: Painting,
    teachers: Teachers,
    threads: int,
    photos: tuple[Picture, Picture] | None = None,
) -> Values:
    """How much a frame differs from an earlier one that optical flow moved to its place.

    One camera path through the recovered input cameras, one flow (of the frames in the scene's own
    colours), the same pixels for everybody. `own colours` is what remains where nothing was
    stylized: errors of the flow, and of resampling. 2D stylizers paint the same frames one by one.
    `the photos` are the world itself, from the first input to the last: what even it is charged
    with, as its flow is wrong where much is hidden.

    Args:
        own: the Gaussians in the scene's own colours.
        stylized: the same in the painting's.
        cameras: the recovered ones, at least two.
        painting: the style.
        teachers: measures and 2D stylizers.
        threads: for the renderer.
        photos: the first and the last input, of the frames' size.
    """
    needed = sorted({index for pairs in PAIRS.values() for pair in pairs for index in pair})
    path, drawing = camera_path(cameras, FRAMES), Drawing(threads=threads)
    frames = {k: drawing.frame(own, path[k]) for k in needed}
    plain: dict[int, Picture] = {k: frame.colour.clip(0, 1) for k, frame in frames.items()}
    movies: dict[str, dict[int, Picture]] = {
        MODEL: {k: drawing.frame(stylized, path[k]).colour.clip(0, 1) for k in needed},
        OWN: plain,
    }
    for name, stylizer in teachers.stylizers.items():
        movies[name] = {k: stylizer(plain[k], painting.picture) for k in needed}
    values: Values = {}
    for reach, pairs in PAIRS.items():
        for a, b in pairs:
            alphas = (frames[a].alpha, frames[b].alpha)
            motion = find_motion(frames[a].colour, frames[b].colour, teachers, alphas)
            key = ("consistency", f"{reach} share of pixels compared", MODEL)
            values.setdefault(key, []).append(float(motion.valid.mean()))
            if motion.valid.any():
                for method, movie in movies.items():
                    measures = disagreement(movie[a], movie[b], motion, teachers)
                    for name, value in measures.items():
                        key = ("consistency", f"{reach} {name}", method)
                        values.setdefault(key, []).append(value)
    if photos is not None:
        motion = find_motion(*photos, teachers)
        for name, value in disagreement(*photos, motion, teachers).items():
            values["consistency", f"whole {name}", PHOTOS] = [value]
    return values


def camera_path(cameras: Sequence[Camera], frames: int) -> list[Camera]:
    """At even steps from the first camera to the last, through all of them in order."""
    stops = [poses.from_camera(camera) for camera in cameras]
    path = []
    for time in np.linspace(0, len(stops) - 1, frames):
        segment = min(int(time), len(stops) - 2)
        pose = poses.blend(stops[segment], stops[segment + 1], time - segment)
        path.append(poses.to_camera(pose, cameras[0]))
    return path


def find_motion(
    a: Picture, b: Picture, teachers: Teachers, alphas: tuple[Picture, Picture] | None = None
) -> Motion:
    """Optical flow between two pictures in their own colours, and where it says something.

    Args:
        a: (H, W, 3), the earlier one.
        b: (H, W, 3), the later one.
        teachers: their flow.
        alphas: (H, W) each, what is covered; None for all.
    """
    before, after = np.ones((2, *a.shape[:2]), np.float32) if alphas is None else alphas
    flow = teachers.flow(a, b)
    importance = brightness_importance(a.clip(0, 1), b.clip(0, 1), flow)
    moved, cover = splat(before[..., None], flow, importance)
    valid = (cover >= LEAST_COVER) & (moved[..., 0] >= LEAST_COVER) & (after >= LEAST_COVER)
    return Motion(flow, importance, valid)


def disagreement(a: Picture, b: Picture, motion: Motion, teachers: Teachers) -> dict[str, float]:
    """RMSE over the valid pixels, also relative to their contrast, and LPIPS, others black.

    Dull frames agree in RMSE whatever they show; the one relative to contrast (the standard
    deviation of b's valid pixels) does not let them.
    """
    moved, _ = splat(a, motion.flow, motion.importance)
    seen = b[motion.valid]
    rmse = float(np.sqrt(np.mean((moved[motion.valid] - seen) ** 2)))
    mask = motion.valid[..., None]
    return {
        "RMSE": rmse,
        "RMSE over contrast": rmse / max(float(seen.std()), LEAST_CONTRAST),
        "LPIPS": teachers.lpips(moved * mask, b * mask),
    }
