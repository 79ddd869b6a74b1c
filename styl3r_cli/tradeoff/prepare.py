"""What has to be there before points are measured: other precisions, and what is true."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.photo_frames import frames_of_photos, known_cameras, read_cameras_of
from styl3r_cli.cameras.poses import Array
from styl3r_cli.console import Console
from styl3r_cli.errors import InputError, ModelError
from styl3r_cli.graphs import find
from styl3r_cli.locate import locate_views
from styl3r_cli.manifest import APPEARANCE, MANIFEST, STRUCTURE, check_file, read_manifest
from styl3r_cli.photos import load_photos, load_style
from styl3r_cli.photos.depth import read_depth
from styl3r_cli.photos.resize import fit_map
from styl3r_cli.photos.views import same_shape
from styl3r_cli.pipeline import Stylizer
from styl3r_cli.tradeoff.points import GIVEN

QUANTISERS = ("onnx", "onnx_ir")  # modules that making other precisions needs


def model_folders(
    model: str,
    precisions: Sequence[str],
    folder: Path,
    photos: Sequence[Path],
    styles: Sequence[Path],
    console: Console,
) -> dict[str, str]:
    """The model in each precision; those that cannot be made here are left out with a note.

    They are made in `folder`, from the same photos that are measured, and used again by a run that
    goes on with an interrupted one.
    """
    source = find(model)
    made = {GIVEN: str(source)}
    weights = read_manifest(source)
    wanted = [name for name in precisions if name != GIVEN]
    missing = [name for name in QUANTISERS if find_spec(name) is None]
    if missing and wanted:
        console.note(
            f"no other precisions without {', '.join(missing)}: pip install 'styl3r[export]'"
        )
        return made
    for precision in wanted:
        if precision == weights.precision:
            continue
        target = folder / precision
        try:
            if not _is_made(target, weights.weights_id):
                with console.stage(f"model in {precision}"):
                    _make(source, target, precision, photos, styles)
            made[precision] = str(target)
        except ModelError as error:
            console.note(f"{precision} cannot be made: {error}")
    return made


def _is_made(target: Path, weights_id: str) -> bool:
    """Whether an earlier run made it of these weights, and it is whole.

    Its files go where the manifest is damaged: nothing else tells that they are an export's, which
    alone is replaced.
    """
    if not (target / MANIFEST).is_file():
        return False
    try:
        made = read_manifest(target)
    except ModelError:
        for name in (MANIFEST, STRUCTURE, APPEARANCE):
            (target / name).unlink(missing_ok=True)
        return False
    try:
        for name in made.files:
            check_file(target, name, made)
    except ModelError:
        return False
    return made.weights_id == weights_id


def _make(
    source: Path, target: Path, precision: str, photos: Sequence[Path], styles: Sequence[Path]
) -> None:
    from styl3r_export.quantise.calibration import Sample
    from styl3r_export.quantise.folders import convert_folder

    views = load_photos(list(photos))
    pictures = [load_style(path).image for path in styles]
    # What it loses is measured anyway, so that a broken one can be shown.
    samples = [Sample(photos[0].parent.name, views, pictures)]
    convert_folder(source, target, precision, samples, verify=False)


def true_cameras(
    source: Path | None, photos: Sequence[Path], console: Console
) -> list[Camera | None]:
    """Where each photo was taken from, as a file says; empty without one.

    Raises:
        InputError: it cannot be read, or does not know the first photo's camera and another's.
    """
    if source is None:
        return []
    found, notes = known_cameras(source, photos)
    if photos[0] not in found or len(found) == 1:
        raise InputError(
            f"{source}: errors are relative to the first photo; "
            f"the file must have cameras for {photos[0].name} and another one"
        )
    for note in notes:
        console.note(note)
    return [found.get(photo) for photo in photos]


def true_depths(
    source: Path | None, photos: Sequence[Path], sides: Sequence[int], console: Console
) -> dict[int, list[Array | None]]:
    """How far away things are at the pixels of the network's pictures, as a camera file names it.

    The file's unit of length is not asked for: depths are compared after scaling.

    Args:
        source: a transforms.json whose frames have a `depth_file_path`, or None.
        photos: the views.
        sides: of the network's square pictures, pixels.
        console: told of depth pictures that know nothing.

    Returns:
        By side, for each photo, (side, side) depths along the view axis, 0 where it is not known;
        None for a photo without depths. Empty where no photo has any.

    Raises:
        InputError: a depth picture cannot be read, or has another shape than its photo.
    """
    if source is None:
        return {}
    file = read_cameras_of(photos, source)
    maps: dict[int, list[Array | None]] = {side: [None] * len(photos) for side in sides}
    known = False
    for photo, frame in frames_of_photos(file, photos, str(source)).items():
        if not file.depth_paths[frame]:
            continue
        path = source.parent / file.depth_paths[frame].replace("\\", "/")
        values, size = read_depth(path), (file.cameras[frame].width, file.cameras[frame].height)
        if not same_shape(values.shape[::-1], size):
            shapes = [f"{across}x{down}" for across, down in (values.shape[::-1], size)]
            raise InputError(
                f"{path}: {shapes[0]} pixels are another shape than {photo.name}'s {shapes[1]}"
            )
        values = np.where(np.isfinite(values) & (values > 0), values, 0)
        if not values.any():
            console.note(f"{path}: knows no depth")
            continue
        known = True
        for side in sides:
            found = fit_map(values, size, (side, side)).astype(np.float64)
            maps[side][photos.index(photo)] = found
    return maps if known else {}


def held_out_poses(
    model: str,
    photos: Sequence[Path],
    held_out: Sequence[Path],
    size: int,
    fov: float | None,
    cameras: Path | None,
    threads: int | None,
) -> dict[str, Any]:
    """Where the held-out photos were taken, by the model as given, which sees all photos for it.

    The pictures that are compared with them come from the other photos alone.

    Returns:
        World-to-camera matrices of the views and of the held-out photos, in one world.
    """
    paths = [*photos, *held_out]
    known = known_cameras(cameras, paths)[0] if cameras else None
    everything = load_photos(paths, (size, size), fov, known)
    scene = Stylizer(model, "cpu", threads).encode(everything)
    _, found = locate_views(scene, everything, threads)
    poses = [camera.extrinsics.tolist() for camera in found.cameras]
    return {"views": poses[: len(photos)], "poses": poses[len(photos) :]}
