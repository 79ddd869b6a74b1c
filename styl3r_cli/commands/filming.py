"""What `render` does: a scene and cameras in; a video, pictures or EXR frames out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from styl3r_cli import __version__, limits, needs
from styl3r_cli.commands.options import STDOUT
from styl3r_cli.commands.render_request import (
    LINEAR,
    RenderRequest,
    background_of,
    check,
    check_frames,
    check_size,
    frame_names,
    stays_behind,
)
from styl3r_cli.commands.scene_file import load
from styl3r_cli.commands.shots import Shots, plan_shots
from styl3r_cli.console import Console
from styl3r_cli.formats import Scene
from styl3r_cli.frames import (
    Drawing,
    Look,
    Tally,
    coarse,
    colours,
    depths,
    draw,
    side_by_side,
    wipe,
    write_picture,
)
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.movies import FILES as MOVIES
from styl3r_cli.quality import SHARES
from styl3r_cli.video import frame_rate

SCENE_KEYS = ("generator", "model")  # of a scene's metadata, for the frames made of it


def film(request: RenderRequest, quiet: bool) -> None:
    """Render what was asked for.

    Raises:
        Styl3rError: the scene, the cameras or the output is unusable.
    """
    console = Console(quiet)
    drawing = Drawing(background_of(request), request.threads, request.antialias)
    check(request)
    with console.stage("scene"):
        scene = _read(request.scene, console)
        other = _read(str(request.compare), console) if request.compare else None
        shots = plan_shots(request, scene, console)
        first = shots.cameras[0]
        check_size(request, first.width, first.height)
        check_frames(request, len(shots.cameras))
        if left := stays_behind(request, len(shots.cameras)):
            console.note(f"{left} is of an earlier film, and stays")
        count = len(scene.gaussians) + (len(other.gaussians) if other else 0)
        area = first.width * first.height * request.beside
        limits.check(needs.drawing(area, count, request.kind in MOVIES))
    if request.save_path:
        frame_rate(shots.fps)  # or a refusal would leave the path's file, with endless seconds
        from styl3r_cli.cameras.camera_path import write_camera_path

        write_camera_path(request.save_path, shots.cameras, shots.fps, shots.loop)
    # Of a scene without Gaussians it was said before.
    shown = [each for each in (scene, other) if each is not None]
    tallies = [Tally() if len(each.gaussians) else None for each in shown]
    drawings = [replace(drawing, tally=tally) for tally in tallies]
    with console.stage("render", len(shots.cameras)) as drawn:
        if request.kind == LINEAR:
            _write_linear(request, scene, shots, drawings[0], drawn)
        else:
            look = _look(request, [each.gaussians for each in shown], shots, drawings)
            _write(request, look, shots, drawn)
    for source, tally in zip((request.scene, str(request.compare)), tallies, strict=False):
        if tally is not None and tally.empty:
            share = f"{tally.empty} of {tally.frames} frames"
            console.note(f"{source}: nothing of it is to be seen in {share}")
    if request.kind == "rgb":
        pixels = "rgb24" if drawing.background is not None else "rgba"
        width = first.width * request.beside
        console.note(f"raw {pixels}, {width}x{first.height}, {shots.fps:g} frames per second")


def _read(source: str, console: Console) -> Scene:
    scene = load(source).scene
    for note in scene.notes:
        if note not in console.notes:  # the other scene's may be the same
            console.note(note)
    if not len(scene.gaussians):
        console.note(f"{source}: no Gaussians in it: nothing is to be seen")
    return scene


def _look(
    request: RenderRequest, scenes: list[Gaussians], shots: Shots, drawings: list[Drawing]
) -> Look:
    """What a picture shows: colour or depth, of one scene or of two, each drawn in its way."""
    share = SHARES[request.quality]

    def of(scene: Gaussians, drawing: Drawing) -> Look:
        if request.show == "depth":
            return coarse(depths(scene, drawing, shots.cameras, request.colour_map), share)
        return coarse(colours(scene, drawing), share)

    looks = [of(*pair) for pair in zip(scenes, drawings, strict=True)]
    if len(looks) == 2:
        combine = {"side": side_by_side, "wipe": wipe}[request.layout]
        return combine(looks[1], looks[0])
    if request.show == "both":
        uncounted = replace(drawings[0], tally=None)
        depth = coarse(depths(scenes[0], uncounted, shots.cameras, request.colour_map), share)
        return side_by_side(colours(scenes[0], drawings[0]), depth)
    return looks[0]


def _write(request: RenderRequest, look: Look, shots: Shots, drawn: Callable[[], None]) -> None:
    """A video, or numbered pictures."""
    pictures = draw(look, shots.cameras, drawn)
    if request.one_file:
        from styl3r_cli.movies import write_movie

        target = None if request.output == STDOUT else request.file
        write_movie(target, pictures, shots.fps, request.kind)
        return
    names = frame_names(request.file, len(shots.cameras))
    for name, picture in zip(names, pictures, strict=True):
        write_picture(name, picture, request.kind)


def _write_linear(
    request: RenderRequest,
    scene: Scene,
    shots: Shots,
    drawing: Drawing,
    drawn: Callable[[], None],
) -> None:
    """EXR frames, with what the scene says of its own origin."""
    from styl3r_cli.exr import ExrOptions, write_exr

    told = {key: scene.metadata[key] for key in SCENE_KEYS if key in scene.metadata}
    provenance = {"software": f"styl3r {__version__}"}
    provenance |= {f"styl3r.{key}": value for key, value in told.items()}
    options = ExrOptions(
        request.exr_compression, request.exr_parts == "multi", shots.fps, provenance
    )
    drawing = replace(drawing, background=None)
    names = frame_names(request.file, len(shots.cameras))
    for name, camera in zip(names, shots.cameras, strict=True):
        write_exr(name, drawing.frame(scene.gaussians, camera), camera, options)
        drawn()
