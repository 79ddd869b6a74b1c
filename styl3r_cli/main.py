"""The `styl3r` command: finds the subcommand, and turns every failure into one line and a code."""

from __future__ import annotations

import errno
import os
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from itertools import pairwise, takewhile, zip_longest
from typing import NoReturn

import click

from styl3r_cli import __version__, console, endings, environment, limits, memory, needs
from styl3r_cli.errors import BROKEN_PIPE, MEANINGS, ExitCode, Styl3rError
from styl3r_cli.files import ClosedOutput, keep_stdout_for_results

# Name: (module in styl3r_cli.commands, one line of help). The modules are imported on use only,
# so that the list of commands needs none of their libraries.
COMMANDS = {
    "stylize": ("stylize", "Photos and a style picture become a stylized 3D scene."),
    "reconstruct": ("reconstruct", "Photos become a 3D scene in their own colours."),
    "render": ("render", "A scene becomes a video or a folder of frames."),
    "view": ("view", "A scene in the browser, to walk around in (needs the extra 'view')."),
    "convert": ("convert", "A scene from one file format into another."),
    "compact": ("compact", "A scene with only as many Gaussians as it requires."),
    "info": ("info", "What is in a scene file."),
    "bench": ("bench", "How fast this machine draws scenes."),
    "tradeoff": ("tradeoff", "What speed costs in accuracy, measured on your photos."),
    "completion": ("completion", "What a shell needs to complete styl3r's commands and options."),
    "export": ("export", "A checkpoint becomes a model folder (needs the extra 'export')."),
}
HIDDEN = {"man": ("man", "The manual page: styl3r man | man -l -")}
DEBUG = "STYL3R_DEBUG"  # set to 1, a bug shows its traceback
COMPLETION = "_STYL3R_COMPLETE"  # click's; what else a shell sets then may be missing or wrong
FOR_SHELLS = f"{COMPLETION} is for shells: see styl3r completion --help"
OUT_OF_MEMORY = "out of memory"
SMALLER = "; try a smaller --size, or fewer and smaller photos"
# What else there is to say of it, where a command has options for that.
ADVICE = {
    "stylize": SMALLER,
    "reconstruct": SMALLER,
    "render": "; try a smaller --size",
    "bench": "; try smaller --sizes, or fewer --gaussians",
    "tradeoff": "; try fewer and smaller photos",
}


# What writing fails with: a full disk, a terminal that is gone, a stream that is for reading.
UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)


def exit_code_columns() -> str:
    """What there is, in two columns."""
    rows = [f"{code:<4} {meaning}" for code, meaning in MEANINGS.items()]
    half = (len(rows) + 1) // 2
    pairs = zip_longest(rows[:half], rows[half:], fillvalue="")
    return "\n".join(f"  {left:<30} {right}".rstrip() for left, right in pairs)


HELP = """\
2 to 8 photos of a place and one painting become a stylized 3D scene, on any CPU.

\b
  styl3r stylize photos/ --style art.jpg -o scene.ply --video scene.mp4

`styl3r COMMAND --help` explains a command.
"""
EPILOG = f"""\b
Exit codes:
{exit_code_columns()}

Results go to the files that you name, or to standard output with '-'; notes and progress go to
standard error. {DEBUG}=1 shows the traceback of a bug; NO_COLOR=1 turns colours off;
{console.LOG}=json makes every note and error a line of JSON, as --log does."""


class LazyGroup(click.Group):
    """A group that knows its commands' names and imports a command when it is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names, in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import one command; None if there is none of that name."""
        known = COMMANDS | HIDDEN
        if cmd_name not in known:
            return None
        command = import_module(f"styl3r_cli.commands.{known[cmd_name][0]}").command
        from styl3r_cli.commands.options import FileName

        for parameter in command.params:
            if isinstance(parameter, click.Argument) and parameter.type is click.STRING:
                parameter.type = FileName()  # what shells then complete as such
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As click does, with an error that says what there is."""
        if args and not args[0].startswith("-") and args[0] not in COMMANDS | HIDDEN:
            known = ", ".join(COMMANDS)
            raise click.UsageError(f"there is no command '{args[0]}'; there are {known}", ctx)
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> object:
        """As click does, but Ctrl-C prints no empty line, and a closed pipe has its own code."""
        limits.check(needs.at_all())
        limits.check_threads()
        environment.clear()
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise click.exceptions.Exit(ExitCode.INTERRUPTED) from None
        except BrokenPipeError:
            sys.stdout = None  # type: ignore[assignment]  # or Python flushes it again at exit
            raise click.exceptions.Exit(BROKEN_PIPE) from None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The table, without importing anything."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.command(
    cls=LazyGroup,
    help=HELP,
    epilog=EPILOG,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, message="%(prog)s %(version)s")
def group() -> None:
    """2 to 8 photos of a place and one painting become a stylized 3D scene."""


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit (the console script's entry point)."""
    _fill_standard_streams()
    keep_stdout_for_results()
    endings.unwind_on_signals()
    if not sys.warnoptions:  # libraries' remarks on odd files are not for users; python -W shows
        warnings.simplefilter("ignore")
    try:
        code = run(arguments)
    except SystemExit as asked:  # by a signal
        code = asked.code if isinstance(asked.code, int) else ExitCode.INTERNAL
    if code == ExitCode.SUCCESS:
        endings.finish()
        _flush(code)
    endings.leave(code)


def _flush(code: int) -> None:
    """Have results reach standard output; where that fails, Python's own end tells."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError, AttributeError):
        sys.exit(code)


def _fill_standard_streams() -> None:
    """Where a stream is closed, no file may get its number: libraries in C would write into it."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free
    if sys.stdout is None:
        sys.stdout = ClosedOutput()


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command line and return the exit code; failures are told on stderr."""
    given = sys.argv[1:] if arguments is None else arguments
    asked = os.environ.get(console.LOG) or console.LOG_FORMATS[0]
    console.use_format(asked)
    if asked not in console.LOG_FORMATS:
        known = " or ".join(console.LOG_FORMATS)
        return _fail(f"{console.LOG}={asked}: {known}, or not set", ExitCode.USAGE)
    try:
        result = group.main(
            args=None if arguments is None else list(arguments),
            prog_name=console.PROGRAM,
            standalone_mode=False,
        )
    except Styl3rError as error:
        if isinstance(error.__cause__, BrokenPipeError):
            return BROKEN_PIPE
        return _fail(str(error), error.exit_code)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        return ExitCode.USAGE
    except click.ClickException as error:
        if _asks_for_json(given):
            console.use_format("json")
        return _fail(_usage_message(error, _named(given)), ExitCode.USAGE)
    except (KeyboardInterrupt, click.Abort):
        return ExitCode.INTERRUPTED
    except SystemExit as asked:  # click's, of a shell or a wish that it does not know
        if asked.code != ExitCode.INTERNAL or not os.environ.get(COMPLETION):
            raise
        return _fail(FOR_SHELLS, ExitCode.USAGE)
    except Exception as error:  # whatever it is, a user sees one line
        if os.environ.get(DEBUG) == "1":
            raise
        if memory.ended(error):
            return _fail(OUT_OF_MEMORY + ADVICE.get(_named(given), ""), ExitCode.INTERNAL)
        if os.environ.get(COMPLETION):
            return _fail(FOR_SHELLS, ExitCode.USAGE)
        if isinstance(error, OSError) and error.filename:  # a name that no file can have, say
            return _fail(f"{os.fsdecode(error.filename)}: {error.strerror}", ExitCode.INPUT)
        if isinstance(error, OSError) and error.errno in UNWRITABLE:  # files have their own message
            return _fail(f"cannot write standard output: {error.strerror}", ExitCode.OUTPUT)
        what = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        return _fail(f"a bug: {what} ({DEBUG}=1 shows where; please report it)", ExitCode.INTERNAL)
    return result if isinstance(result, int) else ExitCode.SUCCESS


def _named(arguments: Sequence[str]) -> str:
    """The command that a command line names; empty for none."""
    return next((word for word in arguments if word in COMMANDS), "")


def _usage_message(error: click.ClickException, command: str) -> str:
    """Click's message in one line, with the way to the right help."""
    message = error.format_message().strip().rstrip(".").replace("\n\t", " ")
    context = getattr(error, "ctx", None)  # missing where an option has no value
    path = context.command_path if context else f"{console.PROGRAM} {command}".strip()
    return f"{message} (see {path} --help)"


def _asks_for_json(arguments: Sequence[str]) -> bool:
    """Whether --log is in a command line that click gave up on before it came to that option."""
    options = list(takewhile("--".__ne__, arguments))
    return "--log=json" in options or ("--log", "json") in pairwise(options)


def _fail(message: str, code: ExitCode) -> int:
    console.error(message, code)
    return code
