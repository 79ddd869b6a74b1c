"""`styl3r stylize`: photos and style pictures become a stylized scene."""

from __future__ import annotations

from typing import Any

import click

from styl3r_cli.commands.options import Number, StyleType, WeightedStyle, scene_options
from styl3r_cli.quality import BEST, QUALITIES, help_of

HELP = """\
Make a stylized 3D scene from 2 to 8 photos of one place.

PHOTOS are picture files, globs or a folder; of more than 8, a well-spread 8 are used. '-' reads
their names from standard input.

\b
  styl3r stylize photos/ --style art.jpg -o scene.ply --video scene.mp4
  styl3r stylize a.jpg b.jpg --style one.jpg=2 --style other.jpg=1 --strength 0.7 -o scene.ply
  styl3r stylize photos/ --style art.jpg -o - | styl3r render - -o scene.mp4
  styl3r stylize photos/ -s art.jpg -s ink.jpg --each -o out/{style}.ply
  find photos -name '*.jpg' | sort | styl3r stylize - --style art.jpg -o scene.ply
  find photos -name '*.jpg' -print0 | sort -z | styl3r stylize -0 - --style art.jpg -o scene.ply

Existing results are replaced; a photo or a style is never overwritten.
"""


@click.command("stylize", help=HELP)
@click.option(
    "--style",
    "-s",
    "styles",
    type=StyleType(),
    multiple=True,
    required=True,
    help="A style picture; several are blended by their weights.",
)
@click.option(
    "--each",
    is_flag=True,
    help="A scene for each style instead of one of their blend: the photos are read once, and "
    "{style} in the outputs' names becomes the picture's name.",
)
@click.option(
    "--strength",
    type=Number(0, 1),
    default=1.0,
    show_default=True,
    help="How much of the style: 0 keeps the scene's own colours.",
)
@click.option(
    "--quality",
    type=click.Choice(QUALITIES),
    default=BEST,
    show_default=True,
    help="Best fits the colours to the views and leaves out Gaussians that nobody would miss; "
    "balanced does neither; draft also reads the photos at half the model's size (--size says "
    "another). The example scene of four photos, and how well its pictures agree with the "
    f"best before anything is left out: {help_of('stylize')}.",
)
@scene_options
def command(styles: tuple[WeightedStyle, ...], strength: float, **options: Any) -> None:
    """Make a stylized 3D scene from 2 to 8 photos of one place."""
    from styl3r_cli.commands.scene import SceneRequest, make_scene

    make_scene(SceneRequest(command="stylize", styles=styles, strength=strength, **options))
