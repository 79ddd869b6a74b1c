"""`styl3r view`: a scene in the browser, to walk around in."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path

import click

from styl3r_cli.commands.options import STDOUT, UserPath, quiet_option
from styl3r_cli.errors import InputError, UsageError
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.viewer.address import DEFAULT_HOST, find_address

HELP = """\
Show a scene in the browser: turn it, walk through it, compare it with another.

\b
  styl3r view scene.ply
  styl3r view stylized.ply --compare original.ply
  styl3r view scene.spz --port 9000 --no-open
  styl3r stylize photos/ --style art.jpg -o - | styl3r view -

The page starts where the first photo was taken, and shows where the others were on demand. It
stays on this machine (127.0.0.1) unless --host says otherwise; its address is printed on standard
output. Ctrl-C ends it. Needs the extra 'view': pip install 'styl3r[view]'
"""
PATIENCE = 3600.0  # seconds of one sleep; any signal ends it


@click.command("view", help=HELP)
@click.argument("source", metavar="SCENE|-")
@click.option(
    "--compare",
    type=UserPath(),
    metavar="OTHER.ply",
    help="Another scene to switch to and back: the photos' own colours, say.",
)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    help="Where the page is; by default 8080, or any other if that is taken, as 0 asks for.",
)
@click.option(
    "--host",
    default=DEFAULT_HOST,
    show_default=True,
    metavar="ADDRESS",
    help="Who can open the page: 0.0.0.0 is everybody who can reach this machine.",
)
@click.option(
    "--open/--no-open",
    "in_browser",
    default=True,
    help="Open the browser (the default), or print the page's address only.",
)
@quiet_option
def command(
    source: str, compare: Path | None, port: int | None, host: str, in_browser: bool, quiet: bool
) -> None:
    """Show a scene in the browser."""
    if find_spec("viser") is None:
        raise UsageError("view needs viser; install it with: pip install 'styl3r[view]'")
    from styl3r_cli.cameras.stored import cameras_from_metadata, damage
    from styl3r_cli.commands.checks import check_printable
    from styl3r_cli.commands.scene_file import check_two, load
    from styl3r_cli.console import Console
    from styl3r_cli.viewer.server import serving

    check_printable()
    check_two(source, compare)
    console = Console(quiet)
    address = find_address(host, port)
    sources = [source, str(compare)] if compare else [source]
    with console.stage("read"):
        scenes = [load(each).scene for each in sources]
    for note in dict.fromkeys(note for scene in scenes for note in scene.notes):
        console.note(note)
    cameras = next(filter(None, (cameras_from_metadata(each.metadata) for each in scenes)), [])
    if not cameras and not any(damage(each.metadata) for each in scenes):  # which is noted
        console.note("no cameras came with the scene; the page starts at a view of all of it")
    if not address.private:
        console.note(f"--host {host}: whoever can reach this machine can open the page")
    with serving(named(sources, [each.gaussians for each in scenes]), cameras, address) as url:
        click.echo(url)
        if in_browser:
            open_browser(url, console.note)
        console.note("Ctrl-C ends the viewer")
        while True:
            time.sleep(PATIENCE)


def named(sources: Sequence[str], scenes: Sequence[Gaussians]) -> dict[str, Gaussians]:
    """The scenes by what the page calls them: their files' names, or paths if those are equal.

    Raises:
        InputError: a scene has nothing to show.
        UsageError: it is the same scene twice.
    """
    for source, gaussians in zip(sources, scenes, strict=True):
        if len(gaussians) == 0:
            raise InputError(f"{source}: there are no Gaussians in it to show")
    names = ["standard input" if source == STDOUT else Path(source).name for source in sources]
    if len(set(names)) < len(names):
        names = list(sources)
    if len(set(names)) < len(names):
        raise UsageError("--compare is the scene itself; name another one")
    return dict(zip(names, scenes, strict=True))


def open_browser(url: str, note: Callable[[str], None]) -> None:
    """Open the user's browser; where there is no screen, say what to do instead."""
    import webbrowser

    # Without a screen, Python would start a browser for terminals, in this one.
    screen = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and not screen:
        note("no screen here; open the address in a browser yourself")
        return
    try:
        opened = webbrowser.open(url)
    except (webbrowser.Error, OSError):
        opened = False
    if not opened:
        note("no browser could be started; open the address yourself")
