"""What a person sees while a command works: notes, stages and their progress, on stderr."""

from __future__ import annotations

import json
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

PROGRAM = "styl3r"
PATIENCE = 1.0  # seconds that a stage may take before it is worth a progress line
REDRAW = 0.2  # seconds between two states of that line
BAR = 24  # characters
RED, DIM, RESET = "\x1b[31m", "\x1b[2m", "\x1b[0m"
CLEAR_LINE = "\r\x1b[K"
LOG_FORMATS = ("text", "json")
LOG = "STYL3R_LOG"  # the format where no option says, also for errors in the command line itself

_json = False  # whether this run tells everything as JSON


class Console:
    """Notes and progress of one run, and the time that its stages took.

    Notes are one line each, also in a pipe or a log file, unless `quiet`. Progress is for
    terminals only, and only for stages over a second.

    Attributes:
        notes: every note so far, for the JSON report.
        timings: seconds by stage, in the order in which the stages ended.
    """

    def __init__(self, quiet: bool = False) -> None:
        self.notes: list[str] = []
        self.timings: dict[str, float] = {}
        self._start = time.perf_counter()
        self._quiet = quiet
        self._live = not quiet and (_json or is_terminal())
        self._lock = threading.Lock()  # notes may come while the progress line is drawn

    def elapsed(self) -> float:
        """Seconds since the run began."""
        return time.perf_counter() - self._start

    def note(self, text: str) -> None:
        """Tell the user about a decision that was made for them. Repeated notes are told once."""
        if text in self.notes:
            return
        self.notes.append(text)
        if not self._quiet and _json:
            log("note", message=text)
        elif not self._quiet:
            with self._lock:
                clear = CLEAR_LINE if self._live else ""
                _print(f"{clear}{painted(f'{PROGRAM}: ', DIM)}{one_line(text)}\n")

    def tell(self, text: str) -> None:
        """Say how it went to a person who watches, or to a log; nothing that needs a look."""
        if self._live and _json:
            log("fact", message=text)
        elif self._live:
            with self._lock:
                _print(f"{CLEAR_LINE}{painted(f'{PROGRAM}: ', DIM)}{one_line(text)}\n")

    @contextmanager
    def stage(self, name: str, total: int = 0) -> Iterator[Callable[[], None]]:
        """Time a part of the work, and show that it goes on if it takes long.

        Args:
            name: what is being done ("structure", "video"); also the key in `timings`.
            total: how many steps it has, if it can be counted.

        Yields:
            A function to call after each step.
        """
        done = 0
        finished = threading.Event()
        start = time.perf_counter()

        def advance() -> None:
            nonlocal done
            done += 1

        def draw() -> None:
            pause = PATIENCE
            while not finished.wait(pause):
                with self._lock:
                    if not finished.is_set() and _json:
                        log("progress", stage=name, done=done, total=total or None)
                    elif not finished.is_set():
                        line = progress_line(name, done, total, time.perf_counter() - start)
                        _print(CLEAR_LINE + line)
                pause = PATIENCE if _json else REDRAW
            with self._lock:
                if pause == REDRAW:  # something was drawn
                    _print(CLEAR_LINE)

        painter = threading.Thread(target=draw, daemon=True) if self._live else None
        if painter:
            painter.start()
        try:
            yield advance
        finally:
            finished.set()
            if painter:
                painter.join()
            took = time.perf_counter() - start
            self.timings[name] = self.timings.get(name, 0.0) + took
            if _json and not self._quiet:
                log("stage", stage=name, seconds=round(took, 4))


def progress_line(name: str, done: int, total: int, seconds: float) -> str:
    """One state of the progress line, at most as wide as the terminal."""
    if total:
        filled = BAR * done // total
        bar = "#" * filled + "." * (BAR - filled)
        line = f"{name} [{bar}] {100 * done // total}% {seconds:.0f} s"
    else:
        line = f"{name} ... {seconds:.0f} s"
    return line[: shutil.get_terminal_size().columns - 1]


def use_format(name: str) -> None:
    """Tell everything in this process as "text" or as "json", one of LOG_FORMATS."""
    global _json
    _json = name == "json"


def log(event: str, **values: object) -> None:
    """One JSON object on a line of its own; text is ASCII, so that no file name can break it."""
    _print(json.dumps({"event": event, **values}) + "\n")


def error(text: str, code: int) -> None:
    """The one line that a failed run ends with."""
    if _json:
        log("error", message=text, exit_code=code)
        return
    clear = CLEAR_LINE if is_terminal() else ""
    _print(f"{clear}{PROGRAM}: {painted('error:', RED)} {one_line(text)}\n")


def one_line(text: str) -> str:
    """The text without line breaks and control characters (file names may hold any of them)."""
    visible = (c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return "".join(visible)


def is_terminal() -> bool:
    """Whether a person watches stderr, on a terminal that can redraw a line."""
    return sys.stderr is not None and sys.stderr.isatty() and os.environ.get("TERM", "") != "dumb"


def painted(text: str, colour: str) -> str:
    """Coloured on a terminal, unless NO_COLOR is set (https://no-color.org)."""
    return f"{colour}{text}{RESET}" if is_terminal() and not os.environ.get("NO_COLOR") else text


def _print(text: str) -> None:
    """Write to stderr; nobody listening is no reason to fail."""
    try:
        sys.stderr.write(text)
        sys.stderr.flush()
    except (OSError, ValueError, AttributeError):
        pass
