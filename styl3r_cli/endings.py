"""How the process ends: signals unwind it once, and nothing that still runs is waited for."""

from __future__ import annotations

import os
import signal
import sys
import time
from contextlib import suppress
from types import FrameType
from typing import NoReturn

from styl3r_cli import files
from styl3r_cli.errors import HANGUP, TERMINATED, ExitCode

CODES = {"SIGINT": ExitCode.INTERRUPTED, "SIGTERM": TERMINATED, "SIGHUP": HANGUP}
# Seconds that unwinding takes at most, as a rule: a signal after that means it.
GRACE = 2.0

_asked: tuple[int, float] | None = None  # the exit code of the first signal, and when it came


def unwind_on_signals() -> None:
    """From now on a signal raises, so that temporary files are removed; under nohup none does."""
    for name in CODES:
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _unwind)
    sys.unraisablehook = _unraisable


def leave(code: int) -> NoReturn:
    """End now: threads that still load or compile something are not waited for.

    Nor does Python take networks, scenes and compiled code apart, which the system takes back
    anyway: 0.15 s of a scene's 3.
    """
    _answer_with(signal.SIG_IGN)
    files.remove_unfinished()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):
            stream.flush()
    os._exit(code)


def finish() -> None:
    """All is written: a signal from here on has nothing to unwind, and ends the process."""
    _answer_with(signal.SIG_DFL)


def _answer_with(action: signal.Handlers) -> None:
    for name in CODES:
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is _unwind:
            signal.signal(number, action)


def _unwind(number: int, _frame: FrameType | None) -> None:
    """Raise at the first signal; a second one must not interrupt what removes the files."""
    global _asked
    if _asked is not None:
        code, when = _asked
        if time.monotonic() - when > GRACE:
            leave(code)
        return
    code = CODES[signal.Signals(number).name]
    _asked = code, time.monotonic()
    if code == ExitCode.INTERRUPTED:
        raise KeyboardInterrupt
    sys.exit(code)


def _unraisable(args: sys.UnraisableHookArgs) -> None:
    """A signal that came where Python drops exceptions, as while it frees something, counts too."""
    if _asked is not None and isinstance(args.exc_value, (KeyboardInterrupt, SystemExit)):
        leave(_asked[0])
    sys.__unraisablehook__(args)
