"""Errors a user can act on, and the exit code that each kind ends the process with."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """What the process's exit status tells a shell script (docs/exit_codes.md)."""

    SUCCESS = 0
    INTERNAL = 1
    USAGE = 2  # click's own code for it
    INPUT = 3
    MODEL = 4
    PARTIAL = 5
    OUTPUT = 6
    INTERRUPTED = 130  # as shells report it


# In the words of --help and the manual page.
MEANINGS = {
    ExitCode.SUCCESS: "done",
    ExitCode.INTERNAL: "a bug, or out of memory",
    ExitCode.USAGE: "wrong command line",
    ExitCode.INPUT: "an input cannot be used",
    ExitCode.MODEL: "the model is missing or damaged",
    ExitCode.PARTIAL: "a batch went through, but not all of it",
    ExitCode.OUTPUT: "a result cannot be written",
    ExitCode.INTERRUPTED: "interrupted (Ctrl-C)",
}
LONGEST_QUOTE = 200  # characters of a library's own message
# How shells report a program that a signal ended; nothing is said then.
BROKEN_PIPE = 128 + 13  # SIGPIPE
HANGUP = 128 + 1  # SIGHUP
TERMINATED = 128 + 15  # SIGTERM
SIGNALS = {
    HANGUP: "its terminal was closed (SIGHUP)",
    BROKEN_PIPE: "whoever read standard output has closed it",
    TERMINATED: "told to end (SIGTERM)",
}


def shortened(text: str) -> str:
    """What a library says, without the rest of what it quotes from a damaged file."""
    return text if len(text) <= LONGEST_QUOTE else f"{text[:LONGEST_QUOTE]}..."


class Styl3rError(Exception):
    """A failure with one line that says what is wrong, where, and what to do."""

    exit_code = ExitCode.INTERNAL


class OutOfMemoryError(Styl3rError):
    """There is not enough memory for what was asked."""


class UsageError(Styl3rError):
    """The command line asks for something that does not make sense."""

    exit_code = ExitCode.USAGE


class InputError(Styl3rError):
    """A file given by the user cannot be read or used."""

    exit_code = ExitCode.INPUT


class ModelError(Styl3rError):
    """A model's graphs are missing, damaged, or do not have the expected signature."""

    exit_code = ExitCode.MODEL


class PartialError(Styl3rError):
    """Some results of several are there, others could not be made."""

    exit_code = ExitCode.PARTIAL


class OutputError(Styl3rError):
    """A result cannot be written where the user asked for it."""

    exit_code = ExitCode.OUTPUT
