"""`styl3r man`: the manual page, made from the commands themselves."""

from __future__ import annotations

import click

HELP = """\
Print styl3r's manual page, which explains every command.

\b
  styl3r man | man -l -
  styl3r man > ~/.local/share/man/man1/styl3r.1    # then: man styl3r
"""


@click.command("man", help=HELP, hidden=True)
@click.pass_context
def command(context: click.Context) -> None:
    """Print the manual page."""
    from styl3r_cli.manual import manual_page

    click.echo(manual_page(context.find_root()), nl=False)
