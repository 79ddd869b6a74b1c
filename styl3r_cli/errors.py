"""Errors a user can act on, and the exit code that each kind ends the process with."""

from __future__ import annotations

from enum import IntEnum


class ExitCode(IntEnum):
    """What the process's exit status tells a shell script (documented in the README)."""

    SUCCESS = 0
    INTERNAL = 1  # a bug: please report it
    USAGE = 2  # the command line is wrong (click's own code for it)
    INPUT = 3  # a photo, style, scene or camera file cannot be used
    MODEL = 4  # the model is missing, damaged or of another kind
    PARTIAL = 5  # a batch went through, but not all of it
    OUTPUT = 6  # a result cannot be written
    INTERRUPTED = 130  # Ctrl-C, as shells report it


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


class OutputError(Styl3rError):
    """A result cannot be written where the user asked for it."""

    exit_code = ExitCode.OUTPUT
