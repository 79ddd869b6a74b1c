"""`styl3r render`: a scene becomes a video or a folder of frames."""

from __future__ import annotations

from typing import Any

import click
from click.core import ParameterSource

from styl3r_cli.commands.options import (
    LOOP_FPS,
    LOOP_FRAMES,
    FileName,
    Number,
    PathName,
    SizeType,
    UserPath,
    quiet_option,
    threads_option,
)
from styl3r_cli.quality import BEST, QUALITIES, help_of

DEFAULT_PATH = "wobble"
MOST_FRAMES = 100_000  # over an hour; all their cameras are in memory at once

HELP = """\
Draw a scene along a camera path, or from the cameras of a file.

\b
  styl3r render scene.ply -o scene.mp4
  styl3r render scene.ply --path orbit --frames 240 --size 1280x720 -o tour.webm
  styl3r render scene.ply --compare original.ply --layout wipe -o wipe.mp4
  styl3r render scene.ply --show depth -o depth.mp4
  styl3r render scene.ply --cameras transforms.json -o views/%04d.png
  styl3r render scene.ply --path dolly --once -o frames/%04d.exr
  styl3r render scene.ply -o - --format y4m | ffmpeg -i - scene.mkv
  styl3r stylize photos/ --style art.jpg -o - | styl3r render - -o scene.mp4

\b
Paths:
  wobble       a small swing around the middle view (the default)
  interpolate  through all views, in their order
  orbit        around the scene's middle: as far as the views go, or a full circle
  spiral       growing and shrinking rounds, in and out
  dolly        straight ahead into the scene
  FILE         a camera path or transforms.json of nerfstudio: each camera is a frame, and with
               --frames they are the stops of a path at constant speed
They are as large as the scene allows: it stays in the frame, and the camera out of it.

EXR frames are for compositors: scene-linear colours with alpha, depth (Z) and the camera.
"""


@click.command("render", help=HELP)
@click.argument("scene", metavar="SCENE.ply|-")
@click.option(
    "--output",
    "-o",
    required=True,
    type=FileName(),
    metavar="OUT.mp4|DIR/%04d.png|-",
    help="A video (.mp4 .webm .gif .webp .y4m), or numbered frames (.png .jpg .exr); '-' writes "
    "to standard output.",
)
@click.option(
    "--format",
    type=click.Choice(["mp4", "webm", "gif", "webp", "y4m", "rgb", "png", "jpg", "exr"]),
    help="What to write, where the name does not say; rgb is raw pixels. Through a pipe, y4m, rgb "
    "and png go out frame by frame.",
)
@click.option(
    "--path", type=PathName(), metavar="NAME|FILE", help="How the camera moves; see above."
)
@click.option(
    "--cameras",
    type=UserPath(),
    metavar="TRANSFORMS.json",
    help="One frame per camera of this file; with --path, the views that the path starts from. "
    "By default the views that styl3r stores in its scenes.",
)
@click.option(
    "--save-path",
    type=UserPath(),
    metavar="OUT.json",
    help="Write the frames' cameras, for nerfstudio and for --path.",
)
@click.option(
    "--frames",
    type=click.IntRange(1, MOST_FRAMES),
    help=f"Frames of a path; {LOOP_FRAMES} by default.",
)
@click.option(
    "--fps",
    type=Number(min=0, min_open=True, max=1000),
    help=f"Frames per second; {LOOP_FPS:g} by default, or what a camera path says.",
)
@click.option(
    "--loop/--once",
    default=True,
    help="Come back to the first frame (the default), or go to the path's end and stop.",
)
@click.option(
    "--speed",
    type=click.Choice(["eased", "constant"]),
    help="Slow at the ends or the same throughout; by default as suits the path.",
)
@click.option(
    "--amplitude",
    type=Number(min=0, min_open=True, max=100),
    default=1.0,
    show_default=True,
    help="How far to move, as a multiple of what suits the scene.",
)
@click.option(
    "--arc",
    type=Number(min=0, min_open=True, max=360),
    metavar="DEGREES",
    help="How far an orbit goes, whatever that shows; 360 is a full circle.",
)
@click.option(
    "--size",
    type=SizeType(),
    metavar="SIDE|WxH",
    help="Frame size; by default the camera file's, else the longer side has 512 pixels.",
)
@click.option(
    "--fov",
    type=Number(1, 170),
    metavar="DEGREES",
    help="Horizontal field of view of the frames; by default the views'.",
)
@click.option(
    "--background",
    metavar="COLOUR",
    help="What is seen where the scene has nothing: a name, #rrggbb or rgb(r,g,b); by default "
    "'surroundings', what is around such holes, blurred into them (other viewers show black). "
    "'transparent' for .png, .webp and .webm; EXR frames keep their alpha anyway.",
)
@click.option(
    "--compare",
    type=UserPath(),
    metavar="OTHER.ply",
    help="Another scene to show with this one, on its left: the photos' own colours, say.",
)
@click.option(
    "--layout",
    type=click.Choice(["side", "wipe"]),
    default="side",
    show_default=True,
    help="Two scenes side by side, or one picture that a moving line parts.",
)
@click.option(
    "--show",
    type=click.Choice(["colour", "depth", "both"]),
    default="colour",
    show_default=True,
    help="The scene, its depth on one scale for all frames, or both side by side.",
)
@click.option(
    "--colour-map",
    type=click.Choice(["turbo", "inferno", "viridis", "grey"]),
    default="turbo",
    show_default=True,
    help="The colours of depth; near is bright (red in turbo).",
)
@click.option(
    "--exr-compression",
    type=click.Choice(["zip", "zips", "piz", "rle", "none", "dwaa", "dwab"]),
    default="zip",
    show_default=True,
    help="Of EXR frames; only dwaa and dwab lose anything.",
)
@click.option(
    "--exr-parts",
    type=click.Choice(["single", "multi"]),
    default="single",
    show_default=True,
    help="Colour and depth in one part, which every program reads, or in one each.",
)
@click.option(
    "--antialias",
    is_flag=True,
    help="Draw Gaussians smaller than a pixel as faint as they are: less shimmer far away. Scenes "
    "that were trained without it lose some fine detail.",
)
@click.option(
    "--quality",
    type=click.Choice(QUALITIES),
    default=BEST,
    show_default=True,
    help="Draft and balanced draw smaller frames and enlarge them. A frame of the example scene, "
    f"and how well its pictures agree with the best: {help_of('render')}.",
)
@threads_option
@quiet_option
def command(speed: str | None, quiet: bool, **options: Any) -> None:
    """Draw a scene along a camera path, or from the cameras of a file."""
    from styl3r_cli.commands.filming import film
    from styl3r_cli.commands.render_request import RenderRequest
    from styl3r_cli.commands.render_unused import check_used

    if options["path"] is None and options["cameras"] is None:
        options["path"] = DEFAULT_PATH
    eased = None if speed is None else speed == "eased"
    request = RenderRequest(eased=eased, **options)
    context = click.get_current_context()
    check_used(request, {name for name in options | {"speed": 0} if _is_given(context, name)})
    film(request, quiet)


def _is_given(context: click.Context, option: str) -> bool:
    return context.get_parameter_source(option) == ParameterSource.COMMANDLINE
