"""Videos in chunks with an evaluation index: which frames are given, and which are drawn."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from styl3r_cli.errors import InputError
from styl3r_export.chunks import Video, find_videos, read_chunk
from styl3r_export.evaluate.groups import Group
from styl3r_export.evaluate.scenes import TrueScene, cropped_view

# Videos with wider lenses are left out, as they are upstream (spec section 11).
WIDEST = 100.0  # degrees


@dataclass(frozen=True)
class Entry:
    """What the index says of a video: frames that are given, frames that are drawn."""

    context: tuple[int, ...]
    targets: tuple[int, ...]


def video_groups(
    folder: Path, index: Path, views: Sequence[int], size: int
) -> Iterator[tuple[str, Callable[[], list[list[Group]]]]]:
    """Name of each video that is both in the index and in the chunks, and what reads its groups.

    Args:
        folder: chunks.
        index: JSON, video to `{"context": [...], "target": [...]}`, or to null for none.
        views: how many frames to give (see `context_frames`).
        size: side of the crops.

    Raises:
        InputError: a file is missing or damaged, or they have no video in common.
    """
    entries, chunks = read_index(index), find_videos(folder)
    # Chunk by chunk, so that each is read once.
    keys = sorted(entries.keys() & chunks.keys(), key=lambda key: (chunks[key], key))
    if not keys:
        raise InputError(f"{index}: none of its {len(entries)} videos is in {folder}")
    for key in keys:
        yield key, partial(_groups, chunks[key], key, entries[key], tuple(views), size)


def read_index(path: Path) -> dict[str, Entry]:
    """The videos of an evaluation index that have an entry.

    Raises:
        InputError: it is no such file.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return {
            str(key): Entry(_frames(entry["context"]), _frames(entry["target"]))
            for key, entry in content.items()
            if entry is not None
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: not an evaluation index: {error!r}") from error


def _frames(numbers: Sequence[int]) -> tuple[int, ...]:
    frames = tuple(int(number) for number in numbers)
    if not frames or min(frames) < 0:
        raise ValueError(f"frames {list(numbers)}")
    return frames


def context_frames(entry: Entry, views: int) -> tuple[int, ...] | None:
    """Which frames are given: the index's, or more at even steps between its first and last.

    Frames that are to be drawn are never given. None where the index has more frames than are
    asked for, or where there are not enough between them.
    """
    if len(entry.context) == views:
        return entry.context
    if len(entry.context) > views:
        return None
    first, last = min(entry.context), max(entry.context)
    free = np.array([k for k in range(first, last + 1) if k not in entry.targets])
    even = np.linspace(first, last, views)
    chosen = sorted({int(free[np.abs(free - at).argmin()]) for at in even}) if len(free) else []
    return tuple(chosen) if len(chosen) == views else None


@lru_cache(maxsize=1)
def _chunk(path: Path) -> dict[str, Video]:
    return {video.key: video for video in read_chunk(path)}


def _groups(
    path: Path, key: str, entry: Entry, views: tuple[int, ...], size: int
) -> list[list[Group]]:
    """The one group for each number of views, or none."""
    video = _chunk(path).get(key)
    if video is None:
        raise InputError(f"{path}: has no video {key}; the chunks' index says otherwise")
    if video.field_of_view() > WIDEST:
        return [[] for _ in views]
    contexts = [context_frames(entry, count) for count in views]
    frames = sorted({*entry.targets, *(k for context in contexts for k in context or ())})
    if frames[-1] >= len(video):
        raise InputError(f"video {key}: the index wants frame {frames[-1]} of {len(video)}")
    place = {frame: number for number, frame in enumerate(frames)}
    scene = TrueScene(key, [])
    for frame in frames:
        photo = video.frame(frame)
        fact = video.fact(frame, photo.size)
        scene.views.append(cropped_view(f"frame {frame}", photo, fact, size))
    targets = tuple(place[frame] for frame in entry.targets)
    return [
        [] if context is None else [Group(scene, tuple(place[k] for k in context), targets)]
        for context in contexts
    ]
