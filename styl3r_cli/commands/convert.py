"""`styl3r convert`: a scene from one file format into another."""

from __future__ import annotations

import click

from styl3r_cli.commands.options import STDOUT, quiet_option
from styl3r_cli.formats import MODULES
from styl3r_cli.names import user_path

HELP = """\
Convert a scene between file formats; the files' suffixes say which.

\b
  styl3r convert scene.ply scene.spz
  styl3r convert scene.sog scene.glb
  styl3r convert scene.ply scene.points.glb
  styl3r stylize photos/ --style art.jpg -o - | styl3r convert - - --to spz > scene.spz

\b
  .ply             the common 3D Gaussian splatting PLY: all values, cameras
  .compressed.ply  SuperSplat's, 16 bytes a Gaussian; cameras
  .splat           32 bytes a Gaussian, for the first web viewers
  .spz             Niantic's, version 3 (2 to 4 are read); the widest-read small one
  .sog             PlayCanvas's, version 2: the smallest; cameras
  .glb             glTF with KHR_gaussian_splatting: all values, cameras
  .points.glb      glTF for programs that know no Gaussians: coloured points and
                   camera frusta; cannot be read back

What a format rounds or has no place for is said on standard error. '-' is standard input or
output, whose formats are recognised, or said by --from and --to.
"""


@click.command("convert", help=HELP)
@click.argument("source", metavar="SCENE|-")
@click.argument("target", metavar="OUT|-")
@click.option(
    "--from",
    "source_format",
    type=click.Choice([suffix[1:] for suffix in MODULES]),
    help="What SCENE is, whatever its name says; by default its suffix, or what it looks like.",
)
@click.option(
    "--to",
    "target_format",
    type=click.Choice([suffix[1:] for suffix in MODULES]),
    help="What OUT becomes; by default its suffix, or ply on standard output.",
)
@quiet_option
def command(
    source: str, target: str, source_format: str | None, target_format: str | None, quiet: bool
) -> None:
    """Convert a scene between file formats."""
    from styl3r_cli.commands.checks import check_outputs, check_stdout
    from styl3r_cli.commands.scene_file import load
    from styl3r_cli.console import Console
    from styl3r_cli.files import write_stdout
    from styl3r_cli.formats import encode_scene, scene_suffix, write_scene

    console = Console(quiet)
    path = user_path(target)
    suffix = f".{target_format}" if target_format else ".ply"
    if target == STDOUT:
        check_stdout("-")
    else:
        suffix = suffix if target_format else scene_suffix(path)
        check_outputs([path], [] if source == STDOUT else [user_path(source)])
    with console.stage("read"):
        scene = load(source, source_format).scene
    with console.stage("write"):
        if target == STDOUT:
            encoded = encode_scene(scene.gaussians, scene.metadata, suffix)
        else:
            encoded = write_scene(path, scene.gaussians, scene.metadata, suffix)
    for note in [*scene.notes, *encoded.notes]:
        console.note(note)
    if target == STDOUT:
        write_stdout(encoded.data)
