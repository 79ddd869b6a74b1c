"""`styl3r reconstruct`: photos become a scene in their own colours."""

from __future__ import annotations

from typing import Any

import click

from styl3r_cli.commands.options import scene_options

HELP = """\
Make a 3D scene in its own colours from 2 to 8 photos of one place.

PHOTOS are picture files, globs or a folder; of more than 8, a well-spread 8 are used. '-' reads
their names from standard input.

\b
  styl3r reconstruct photos/ -o scene.ply --preview sheet.png
  ls photos/*.jpg | styl3r reconstruct - -o scene.ply

It is what `stylize` gives with --strength 0. Existing results are replaced; a photo is never
overwritten.
"""


@click.command("reconstruct", help=HELP)
@scene_options
def command(**options: Any) -> None:
    """Make a 3D scene in its own colours from 2 to 8 photos of one place."""
    from styl3r_cli.commands.scene import SceneRequest, make_scene

    make_scene(SceneRequest(command="reconstruct", styles=(), strength=0.0, **options))
