"""`styl3r completion`: what a shell needs to complete commands, options and files."""

from __future__ import annotations

import click

from styl3r_cli.console import PROGRAM

VARIABLE = "_STYL3R_COMPLETE"  # how click's scripts call the program

HELP = """\
Print a script that makes a shell complete styl3r's commands, options and files.

\b
  bash   echo 'eval "$(styl3r completion bash)"' >> ~/.bashrc
  zsh    echo 'eval "$(styl3r completion zsh)"' >> ~/.zshrc
  fish   styl3r completion fish > ~/.config/fish/completions/styl3r.fish
"""


@click.command("completion", help=HELP)
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def command(context: click.Context, shell: str) -> None:
    """Print a shell's completion script."""
    from click.shell_completion import get_completion_class

    kind = get_completion_class(shell)
    assert kind is not None
    # Not click's source(), which starts the shell to ask for its version.
    script = kind(context.find_root().command, {}, PROGRAM, VARIABLE)
    click.echo(script.source_template % script.source_vars())
