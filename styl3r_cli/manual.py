"""The manual page, from what click knows of the commands: nothing is said twice."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Iterator

import click

from styl3r_cli import __version__, console
from styl3r_cli.errors import MEANINGS, SIGNALS
from styl3r_cli.main import COMMANDS, DEBUG

SUMMARY = "2 to 8 photos of a place and one painting become a stylized 3D scene"
ENVIRONMENT = {
    DEBUG: "Set to 1, a bug shows its traceback.",
    console.LOG: "Set to json, notes and errors are a line of JSON each, as with --log json.",
    "NO_COLOR": "Set to anything, messages have no colours.",
    "TERM": "If it is dumb, messages have no colours and no progress is shown.",
    "NUMBA_CACHE_DIR": "Where the renderer's compiled kernels are kept; by default beside the "
    "package, or in the user's cache where that is read-only.",
    "DISPLAY, WAYLAND_DISPLAY": "Without either, styl3r view starts no browser on Linux.",
}
ITS_OWN_LINES = "\b"  # click's mark of a paragraph whose lines are not to be joined
# What roff would take for a command or print as another sign; examples are to be copied.
ESCAPES = {"\\": r"\(rs", "-": r"\-", "'": r"\(aq", "`": r"\(ga", "^": r"\(ha", "~": r"\(ti"}
_ANSWERS = re.compile("|".join(map(re.escape, ESCAPES)) + r"|[^\x00-\x7f]")


def manual_page(root: click.Context) -> str:
    """The whole page in roff, with the macros of man(7).

    Args:
        root: the context of the `styl3r` group.
    """
    assert isinstance(root.command, click.Group)
    lines = [
        f'.TH STYL3R 1 "" "styl3r {escaped(__version__)}" "User Commands"',
        ".SH NAME",
        rf"styl3r \- {escaped(SUMMARY)}",
        ".SH SYNOPSIS",
        r"\fBstyl3r\fR \fICOMMAND\fR [\fIOPTIONS\fR] ...",
        ".SH DESCRIPTION",
        *_prose(root.command.help or ""),
        ".SH COMMANDS",
    ]
    for name in COMMANDS:
        command = root.command.get_command(root, name)
        assert command is not None
        lines += _command(command, click.Context(command, root, name))
    codes = {str(int(code)): meaning for code, meaning in (MEANINGS | SIGNALS).items()}
    lines += [".SH EXIT STATUS", *_entries(codes.items())]
    lines += [".SH ENVIRONMENT", *_entries(ENVIRONMENT.items())]
    return "\n".join(lines) + "\n"


def escaped(text: str) -> str:
    """Text that roff prints as it is."""

    def sign(match: re.Match[str]) -> str:
        return ESCAPES.get(match[0]) or rf"\[u{ord(match[0]):04X}]"

    return _ANSWERS.sub(sign, text)


def _line(text: str) -> str:
    """A line of text; one that begins with a dot would be a command."""
    return (r"\&" if text.startswith(".") else "") + escaped(text)


def _prose(text: str) -> Iterator[str]:
    """Paragraphs of a help text, and its blocks of lines that stay as they are."""
    for paragraph in re.split(r"\n\s*\n", inspect.cleandoc(text)):
        lines = paragraph.strip("\n").split("\n")
        if lines[0].strip() == ITS_OWN_LINES:
            yield from (".PP", ".nf", *map(_line, lines[1:]), ".fi")
        else:
            yield from (".PP", *(_line(line.strip()) for line in lines))


def _command(command: click.Command, context: click.Context) -> Iterator[str]:
    """A command's usage, help and options; those of the commands in it, if it is a group."""
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            inner = command.get_command(context, name)
            assert inner is not None
            yield from _command(inner, click.Context(inner, context, name))
        return
    yield f".SS {escaped(context.command_path)}"
    pieces = " ".join(command.collect_usage_pieces(context))
    yield rf"\fB{escaped(context.command_path)}\fR {escaped(pieces)}"
    yield from _prose(command.help or "")
    records = (parameter.get_help_record(context) for parameter in command.get_params(context))
    yield from _entries(record for record in records if record and record[1])


def _entries(records: Iterable[tuple[str, str]]) -> Iterator[str]:
    for name, text in records:
        yield from (".TP", rf"\fB{escaped(name)}\fR", _line(" ".join(text.split())))
