"""Which frames of a camera file belong to which photos."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.json_values import load_object
from styl3r_cli.cameras.transforms import CameraFile, transforms_of
from styl3r_cli.errors import InputError
from styl3r_cli.names import real_path
from styl3r_cli.photos.decode import decode

LENS = attrgetter("fx", "fy", "cx", "cy", "width", "height")  # of a camera


def read_cameras_of(photos: Sequence[Path], source: Path) -> CameraFile:
    """Read a transforms.json that is of photos; see `read_transforms`.

    A file that says no size, as Blender's scripts for NeRF write it, is of pictures of
    the photos' size.

    Raises:
        InputError: the file is unusable, or says no size and no photo can be read.
    """
    name, content = load_object(source)
    size = None if _says_sizes(content) else _size_of_first(photos)
    return transforms_of(name, content, size)


def _size_of_first(photos: Sequence[Path]) -> tuple[int, int] | None:
    """(width, height) of the first one that can be read: others are left out later, or refused."""
    for photo in photos:
        with suppress(InputError):
            return decode(photo).image.size
    return None


def _says_sizes(content: dict[str, Any]) -> bool:
    frames = content.get("frames")
    parts = [content] if not isinstance(frames, list) else [content, *frames]
    sized = [isinstance(part, dict) and {"w", "h"} <= part.keys() for part in parts]
    return sized[0] or all(sized[1:])


def known_cameras(source: Path, photos: Sequence[Path]) -> tuple[dict[Path, Camera], list[str]]:
    """The cameras of photos from a camera file; see `read_cameras_of` and `cameras_of_photos`."""
    file = read_cameras_of(photos, source)
    found, missing = cameras_of_photos(file, photos, str(source))
    return found, [*file.notes, *missing]


def cameras_of_photos(
    file: CameraFile, photos: Sequence[Path], name: str = "the camera file"
) -> tuple[dict[Path, Camera], list[str]]:
    """The cameras that belong to the photos; those with no frame are named in a note.

    Returns:
        Cameras by photo, and notes.

    Raises:
        InputError: no frame names any of the photos, or it is not clear which one does.
    """
    frames = frames_of_photos(file, photos, name)
    found = {photo: file.cameras[frame] for photo, frame in frames.items()}
    known = {photo.name for photo in found}  # one of the same name in another folder, say
    missing = [
        str(photo) if photo.name in known else photo.name for photo in photos if photo not in found
    ]
    if not found:
        raise InputError(f"{name}: no frame's file_path is one of the photos ({missing[0]}, ...)")
    return found, [f"{name}: no camera for {', '.join(missing)}"] if missing else []


def frames_of_photos(
    file: CameraFile, photos: Sequence[Path], name: str = "the camera file"
) -> dict[Path, int]:
    """The index of the frame that belongs to each photo, matched by file name.

    Where several frames have a photo's file name, the one that agrees with most of its path is
    taken, and where several photos have a frame's, the photo that does. Photos with no frame are
    left out.

    Raises:
        InputError: as much of a photo's path is in frames that differ, or of a frame's in photos.
    """
    found: dict[Path, int] = {}
    shared: dict[Path, int] = {}
    for photo in photos:
        scores = [_common_end(photo.absolute(), path) for path in file.file_paths]
        shared[photo] = max(scores)
        if not shared[photo]:
            continue
        first, *others = (index for index, score in enumerate(scores) if score == shared[photo])
        for other in others:
            if not _is_the_same(file, first, other):
                which = f"frames {first + 1} and {other + 1} are both of {photo}"
                raise InputError(f"{name}: {which}, and differ; which one is right?")
        found[photo] = first
    return {
        photo: frame
        for photo, frame in found.items()
        if not _belongs_to_another(photo, found, shared, name)
    }


def _is_the_same(file: CameraFile, one: int, other: int) -> bool:
    """Whether two frames say the same of a photo."""
    first, second = file.cameras[one], file.cameras[other]
    depths = file.depth_paths or [""] * len(file.cameras)
    return (
        LENS(first) == LENS(second)
        and np.array_equal(first.extrinsics, second.extrinsics)
        and depths[one] == depths[other]
    )


def _belongs_to_another(
    photo: Path, found: dict[Path, int], shared: dict[Path, int], name: str
) -> bool:
    """Whether a photo's frame is of one of the same name, by the folders that the frame names."""
    for other, frame in found.items():
        if frame != found[photo] or real_path(other) == real_path(photo):
            continue
        if shared[other] == shared[photo]:
            what = f"frame {frame + 1} may be of {photo} and of {other}"
            raise InputError(f"{name}: {what}; give them other names, or folders in the file")
        if shared[other] > shared[photo]:
            return True
    return False


def _common_end(photo: Path, file_path: str) -> int:
    """How many trailing parts two paths share; some files leave the suffix out."""
    ours, theirs = list(photo.parts), list(Path(file_path.replace("\\", "/")).parts)
    if theirs and not Path(theirs[-1]).suffix:
        ours[-1] = photo.stem
    shared = 0
    while shared < min(len(ours), len(theirs)) and ours[-1 - shared] == theirs[-1 - shared]:
        shared += 1
    return shared
