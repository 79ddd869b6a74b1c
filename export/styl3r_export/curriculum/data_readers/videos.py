"""Chunks of posed videos (RE10K, DL3DV) as training batches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from styl3r_cli.photos.resize import fit_photo
from styl3r_export.chunks import Video, chunk_paths, read_chunk
from styl3r_export.cropping import crop_camera
from styl3r_export.curriculum.data import Batch, mirror
from styl3r_export.curriculum.data_readers.sampling import DataSet, Frames, choose_frames

# Inputs nearer to each other than this, in the video's units, give no scale.
SMALLEST_BASELINE = 1e-3


class VideoBatch(NamedTuple):
    """Videos' frames: what is given, and what is to be drawn.

    Lengths are in units of the distance from a video's first input to its last, and the first
    input is the world. Nobody knows the depth: it is 0 everywhere, which `view_agreement` takes
    for unseen; losses that need depth do not apply.
    """

    inputs: Batch
    targets: Batch
    keys: list[str]  # the videos' names


class Sample(NamedTuple):
    """One video's frames, inputs first, as numpy arrays."""

    images: np.ndarray  # (V, 3, S, S) uint8
    extrinsics: np.ndarray  # (V, 4, 4)
    intrinsics: np.ndarray  # (V, 3, 3) normalised
    key: str


def video_batches(
    folder: Path,
    data: DataSet,
    seed: int,
    size: int,
    *,
    inputs: int = 2,
    targets: int = 4,
    side: int = 256,
    first_step: int = 0,
) -> Iterator[VideoBatch]:
    """Endless batches of videos; in each round over the folder every video comes once.

    Args:
        folder: of chunks.
        data: how its frames are chosen.
        seed: of everything random.
        size: videos in a batch.
        inputs: frames given.
        targets: frames to be drawn.
        side: of the square crops.
        first_step: of training, where a run goes on: the inputs' distance depends on it.

    Raises:
        InputError: a chunk is damaged.
        ValueError: no video of the folder can be used.
    """
    rng = np.random.default_rng(seed)
    step, samples = first_step, []
    while True:
        used = 0
        for video in _shuffled(rng, chunk_paths(folder)):
            sample = draw_sample(rng, video, data, step, (inputs, targets), side)
            if sample is None:
                continue
            used += 1
            samples.append(sample)
            if len(samples) == size:
                batch = assemble(samples, inputs)
                yield mirrored(batch) if rng.random() < 0.5 else batch
                step, samples = step + 1, []
        if not used:
            raise ValueError(
                f"{folder}: no video can be used: too short for gaps of "
                f"{data.gaps.bounds(step)} frames, or of another size than {data.frame_size}"
            )


def _shuffled(rng: np.random.Generator, paths: Sequence[Path]) -> Iterator[Video]:
    """Chunks in random order, and their videos in random order within each."""
    for number in rng.permutation(len(paths)):
        videos = read_chunk(paths[number])
        for place in rng.permutation(len(videos)):
            yield videos[place]


def draw_sample(
    rng: np.random.Generator, video: Video, data: DataSet, step: int, counts: tuple[int, int],
    side: int,
) -> Sample | None:  # fmt: skip
    """Frames of a video, or None where it cannot be used (spec section 11)."""
    chosen = choose_frames(rng, len(video), data.gaps.bounds(step), *counts)
    if chosen is None or video.field_of_view() > data.widest:
        return None
    first, last = chosen.inputs[0], chosen.inputs[-1]
    centres = [np.linalg.inv(video.extrinsics[k])[:3, 3] for k in (first, last)]
    baseline = float(np.linalg.norm(centres[1] - centres[0]))
    if baseline < SMALLEST_BASELINE:
        return None
    if data.frame_size is not None and video.size(first) != data.frame_size:
        return None
    return _crop(video, chosen, baseline, side)


def _crop(video: Video, chosen: Frames, baseline: float, side: int) -> Sample:
    images, poses, lenses = [], [], []
    world = np.linalg.inv(video.extrinsics[chosen.inputs[0]])
    for number in (*chosen.inputs, *chosen.targets):
        photo = video.frame(number)
        camera, _, _ = crop_camera(video.fact(number, photo.size), photo.size, side)
        pose = camera.extrinsics @ world
        pose[:3, 3] /= baseline
        poses.append(pose)
        lenses.append(camera.intrinsics / np.array([[side], [side], [1.0]]))
        images.append(fit_photo(photo, (side, side)).transpose(2, 0, 1))
    return Sample(np.stack(images), np.stack(poses), np.stack(lenses), video.key)


def assemble(samples: Sequence[Sample], inputs: int) -> VideoBatch:
    """Samples as tensors, the first `inputs` frames of each as what is given."""
    images, extrinsics, intrinsics = (
        torch.from_numpy(np.stack([getattr(sample, name) for sample in samples])).float()
        for name in ("images", "extrinsics", "intrinsics")
    )
    whole = Batch(images / 255, unknown_depth(images), extrinsics, intrinsics)
    given, drawn = (
        Batch(*(field[:, at] for field in whole)) for at in (slice(0, inputs), slice(inputs, None))
    )
    return VideoBatch(given, drawn, [sample.key for sample in samples])


def unknown_depth(images: Float[Tensor, "batch views 3 H W"]) -> Float[Tensor, "batch views H W"]:
    """What stands for depth that nobody knows."""
    return torch.zeros_like(images[:, :, 0])


def mirrored(batch: VideoBatch) -> VideoBatch:
    """All frames in a mirror."""
    return batch._replace(inputs=mirror(batch.inputs), targets=mirror(batch.targets))


def joined(*sources: Iterator[VideoBatch]) -> Iterator[VideoBatch]:
    """Batches of several data sets, one after the other in each batch ("3 + 3" videos)."""
    for parts in zip(*sources, strict=True):
        inputs, targets = (
            Batch(*(torch.cat(fields) for fields in zip(*batches, strict=True)))
            for batches in ([p.inputs for p in parts], [p.targets for p in parts])
        )
        yield VideoBatch(inputs, targets, [key for part in parts for key in part.keys])


def inputs_only(batches: Iterator[VideoBatch]) -> Iterator[Batch]:
    """What stages that draw nothing train on."""
    for batch in batches:
        yield batch.inputs
