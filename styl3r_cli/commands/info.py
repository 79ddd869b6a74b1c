"""`styl3r info`: what is in a scene file."""

from __future__ import annotations

import click

from styl3r_cli.commands.options import quiet_option
from styl3r_cli.formats import MODULES

HELP = """\
Tell what is in a scene file: how many Gaussians, where and how large, values that are not finite,
the cameras that came along, and how large the scene would be in every format.

\b
  styl3r info scene.ply
  styl3r info scene.spz --json
  styl3r stylize photos/ --style art.jpg -o - | styl3r info -
"""


@click.command("info", help=HELP)
@click.argument("source", metavar="SCENE|-")
@click.option(
    "--from",
    "source_format",
    type=click.Choice([suffix[1:] for suffix in MODULES]),
    help="What SCENE is, whatever its name says; by default its suffix, or what it looks like.",
)
@click.option(
    "--sizes/--no-sizes",
    default=True,
    help="How large the scene would be in every format (the default); that takes the most time.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@quiet_option
def command(
    source: str, source_format: str | None, sizes: bool, as_json: bool, quiet: bool
) -> None:
    """Tell what is in a scene file."""
    from styl3r_cli.commands.report import print_report
    from styl3r_cli.commands.scene_facts import facts, sizes_by_format, table
    from styl3r_cli.commands.scene_file import load
    from styl3r_cli.console import Console

    console = Console(quiet)
    with console.stage("read"):
        file = load(source, source_format)
    for note in file.scene.notes:
        console.note(note)
    report = facts(source, file)
    if sizes:
        with console.stage("sizes", len(MODULES)) as done:
            report["sizes"] = sizes_by_format(file.scene, done)
    if as_json:
        print_report(report | {"metadata": _as_text(report["metadata"])})
    else:
        click.echo(table(report))


def _as_text(metadata: dict[str, str]) -> dict[str, str]:
    """A file's own text with "?" for half characters, which strict readers of JSON refuse."""
    return {key: value.encode("utf-8", "replace").decode() for key, value in metadata.items()}
