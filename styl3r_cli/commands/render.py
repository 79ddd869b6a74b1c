"""`styl3r render`: a scene becomes a video or a folder of frames."""

from __future__ import annotations

from pathlib import Path

import click

from styl3r_cli.commands.options import (
    LOOP_FPS,
    LOOP_FRAMES,
    SizeType,
    UserPath,
    quiet_option,
    threads_option,
)

DEFAULT_PATH = "wobble"

HELP = """\
Draw a scene along a camera path, or from the cameras of a file.

\b
  styl3r render scene.ply -o scene.mp4
  styl3r render scene.ply --path interpolate --frames 240 --size 1280x720 -o tour.mp4
  styl3r render scene.ply --cameras transforms.json -o views/%04d.png
  styl3r render scene.ply -o frames/%04d.exr
  styl3r stylize photos/ --style art.jpg -o - | styl3r render - -o scene.mp4

EXR frames are for compositors: scene-linear colours with alpha, depth (Z) and the camera.
"""


@click.command("render", help=HELP)
@click.argument("scene", metavar="SCENE.ply|-")
@click.option(
    "--output",
    "-o",
    required=True,
    metavar="OUT.mp4|DIR/%04d.png|DIR/%04d.exr|-",
    help="A video, or numbered frames; '-' writes the video to standard output.",
)
@click.option(
    "--path",
    "path_name",
    type=click.Choice(["wobble", "interpolate"]),
    help="How the camera moves: a small swing (the default), or through all views and back.",
)
@click.option(
    "--cameras",
    type=UserPath(),
    metavar="TRANSFORMS.json",
    help="One frame per camera of this file; with --path, the views that the path starts from. "
    "By default the views that styl3r stores in its scenes.",
)
@click.option(
    "--frames", type=click.IntRange(min=1), help=f"Frames of a path; {LOOP_FRAMES} by default."
)
@click.option(
    "--fps",
    type=click.FloatRange(min=0, min_open=True, max=1000),
    default=LOOP_FPS,
    show_default=True,
    help="Frames per second of a video.",
)
@click.option(
    "--size",
    type=SizeType(),
    metavar="SIDE|WxH",
    help="Frame size; by default the camera file's, else the longer side has 512 pixels.",
)
@click.option(
    "--background",
    metavar="COLOUR",
    help="What is behind the scene: a name, #rrggbb or rgb(r,g,b); by default black. "
    "EXR frames keep their alpha instead.",
)
@threads_option
@quiet_option
def command(
    scene: str,
    output: str,
    path_name: str | None,
    cameras: Path | None,
    frames: int | None,
    fps: float,
    size: tuple[int, int] | None,
    background: str | None,
    threads: int | None,
    quiet: bool,
) -> None:
    """Draw a scene along a camera path, or from the cameras of a file."""
    from styl3r_cli.commands.filming import RenderRequest, film

    if frames is not None and cameras is not None and path_name is None:
        raise click.UsageError("--frames needs --path; a camera file alone has its own frames")
    request = RenderRequest(
        scene=scene,
        output=output,
        path=path_name or (DEFAULT_PATH if cameras is None else None),
        cameras=cameras,
        frames=frames or LOOP_FRAMES,
        fps=fps,
        size=size,
        background=background,
        threads=threads,
    )
    film(request, quiet)
