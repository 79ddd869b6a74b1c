"""What `stylize` and `reconstruct` do: photos in; a scene, cameras, a video and a sheet out."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from styl3r_cli import __version__
from styl3r_cli.cameras.framing import uncropped
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.cameras.stored import cameras_to_metadata
from styl3r_cli.commands.each import one_by_one
from styl3r_cli.commands.options import LOOP_FPS, LOOP_FRAMES
from styl3r_cli.commands.report import (
    compaction_report,
    kept_line,
    print_report,
    rounded,
    scene_report,
)
from styl3r_cli.commands.request import Inputs, SceneRequest, load_inputs
from styl3r_cli.console import Console
from styl3r_cli.errors import PartialError
from styl3r_cli.files import write_stdout
from styl3r_cli.formats import Encoded, encode_scene, write_scene
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.painter import Painter
from styl3r_cli.photos import Photos
from styl3r_cli.pipeline import Scene
from styl3r_cli.quality import FITTED

if TYPE_CHECKING:  # it brings numba
    from styl3r_cli.compaction import Compaction

# The path and the frame of `--video`; `styl3r render` has options for both.
VIDEO_PATH = "wobble"
VIDEO_SIDE = 512  # Gaussians are smooth: twice the network's pixels look better than its own


def make_scene(request: SceneRequest) -> None:
    """Run the network and write every result that was asked for.

    Raises:
        PartialError: a style of several scenes could not be used; the other scenes are there.
        Styl3rError: an input, the model or an output is unusable.
    """
    console = Console(request.quiet)
    inputs = load_inputs(request, console)
    with console.stage("structure"):
        scene = inputs.stylizer.encode(inputs.photos)
    with console.stage("cameras"):
        scene, recovered = _recover(scene, inputs.photos, request.threads, console)
    fitted = FITTED[request.quality]
    painter = Painter(inputs.stylizer, scene, recovered, request.threads, fitted)
    shared = rounded(console.timings | {"total": console.elapsed()})
    reports: list[dict[str, Any]] = []
    for index, one in enumerate(one_by_one(request)):
        styles = [inputs.styles[index]] if request.each else inputs.styles
        if None in styles:
            continue
        if not reports:  # cameras are the same for every style
            one = replace(one, cameras_out=request.cameras_out)
        reports.append(_make_one(one, replace(inputs, styles=styles), painter, console))
    if request.json:
        together = {"shared_timings": shared, "scenes": reports}
        print_report(together if request.each else reports[0])
    if inputs.left_out:
        count = f"{len(inputs.left_out)} of {len(inputs.styles)} styles"
        raise PartialError(f"{count} could not be used: {'; '.join(inputs.left_out)}")


def _make_one(
    request: SceneRequest, inputs: Inputs, painter: Painter, console: Console
) -> dict[str, Any]:
    """Colour the scene and write its results; returns the report."""
    earlier, start = dict(console.timings), console.elapsed()
    with console.stage("appearance"):
        pictures = [style.image for style in inputs.usable_styles]
        weights = [style.weight for style in request.styles]
        gaussians, repairs = painter(pictures, weights, request.strength)
    if str(repairs):
        console.note(f"Gaussians repaired: {repairs}")
    recovered, compaction, whole = painter.recovered, None, gaussians
    if request.decibels is not None:
        with console.stage("compact"):
            compaction = painter.compact(gaussians, request.decibels)
        gaussians = compaction.gaussians
    with console.stage("write"):
        encoded = _write(request, inputs, gaussians, recovered, console)
        if compaction is not None:
            compaction = _measured(request, compaction, whole, encoded, console)
    if request.video:
        _film(request, gaussians, recovered, console)
    if request.preview:
        with console.stage("preview"):
            _draw_sheet(request, inputs, painter, gaussians)
    timings = console.timings | {"total": console.elapsed()}
    if request.each:  # what this style took, after what all of them share
        earlier["total"] = start
        timings = {name: took - earlier.get(name, 0.0) for name, took in timings.items()}
    report = scene_report(request, inputs, gaussians, repairs, recovered, console.notes, timings)
    return report | {"compaction": compaction and compaction_report(compaction)}


def _measured(
    request: SceneRequest, made: Compaction, whole: Gaussians, encoded: Encoded, console: Console
) -> Compaction:
    """What a compaction is worth in the file that was written, told."""
    from styl3r_cli.commands.written import as_written, broken_promise

    assert request.decibels is not None
    stored = as_written(made, whole, encoded, request.suffix, request.threads)
    for note in broken_promise(stored, request.suffix, request.decibels):
        console.note(note)
    console.tell(kept_line(stored))
    return stored


def _recover(
    scene: Scene, photos: Photos, threads: int | None, console: Console
) -> tuple[Scene, Recovered]:
    from styl3r_cli.locate import locate_views  # brings OpenCV, which takes a while

    scene, recovered = locate_views(scene, photos, threads)
    for note in recovered.notes:
        console.note(note)
    return scene, recovered


def _write(
    request: SceneRequest,
    inputs: Inputs,
    gaussians: Gaussians,
    recovered: Recovered,
    console: Console,
) -> Encoded:
    """The scene with its cameras, and the camera file; returns the scene's file."""
    metadata = {
        "generator": f"styl3r {__version__}",
        "model": inputs.stylizer.model.name,
        **cameras_to_metadata(recovered.cameras),
    }
    if request.scene_path is None:
        encoded = encode_scene(gaussians, metadata)
        write_stdout(encoded.data)
    else:
        encoded = write_scene(request.scene_path, gaussians, metadata, request.suffix)
    for note in encoded.notes:
        console.note(note)
    if request.cameras_out:
        from styl3r_cli.cameras.transforms import write_transforms

        sizes = zip(recovered.cameras, inputs.photos.sizes, strict=True)
        cameras = [uncropped(camera, *size) for camera, size in sizes]
        folder = request.cameras_out.parent
        write_transforms(
            request.cameras_out, cameras, [_seen_from(folder, path) for path in inputs.photos.paths]
        )
    return encoded


def _seen_from(folder: Path, photo: Path) -> str:
    """The photo's path relative to the camera file's folder, as nerfstudio reads it."""
    try:
        return Path(os.path.relpath(photo, folder)).as_posix()
    except ValueError:  # on another drive
        return photo.resolve().as_posix()


def _film(
    request: SceneRequest, gaussians: Gaussians, recovered: Recovered, console: Console
) -> None:
    """One loop of a camera swing."""
    from styl3r_cli.cameras.paths import make_path
    from styl3r_cli.frames import draw_path, enlarged
    from styl3r_cli.movies import write_movie

    assert request.video is not None
    views = [enlarged(camera, VIDEO_SIDE) for camera in recovered.cameras]
    cameras = make_path(VIDEO_PATH, views, gaussians, LOOP_FRAMES)
    with console.stage("video", len(cameras)) as drawn:
        frames = draw_path(gaussians, cameras, threads=request.threads, drawn=drawn)
        write_movie(request.video, frames, LOOP_FPS, request.video.suffix.lower()[1:])


def _draw_sheet(
    request: SceneRequest, inputs: Inputs, painter: Painter, gaussians: Gaussians
) -> None:
    """The contact sheet; a stylized scene is drawn in its own colours too, to compare."""
    from styl3r_cli.preview import Preview, write_preview

    own = gaussians
    if request.strength > 0:
        own, _ = painter(strength=0)
    preview = Preview(
        images=painter.scene.images,
        names=inputs.photos.names,
        styles=[style.image for style in inputs.usable_styles],
        style_names=[style.name for style in inputs.usable_styles],
        result=gaussians,
        own=own,
        cameras=painter.recovered.cameras,
    )
    title = f"styl3r {request.command}: {len(preview.names)} photos, {len(gaussians):,} Gaussians"
    assert request.preview is not None
    write_preview(request.preview, preview, title, request.threads)
