"""Variables of libraries' that end a run as if by a bug where they are no numbers."""

from __future__ import annotations

import os

from styl3r_cli.errors import UsageError

# numpy reads the first one where numba imports it, OpenCV the second one.
NUMBERS = ("SOURCE_DATE_EPOCH", "OPENCV_FOR_THREADS_NUM")
MOST_DIGITS = 18  # what 64 bits hold, of any number
LONGEST_QUOTE = 40  # characters of a value in a message


def check() -> None:
    """Refuse values that libraries could not read, before one is loaded.

    Raises:
        UsageError: a variable that has to be a whole number is none.
    """
    for name in NUMBERS:
        value = os.environ.get(name)
        if value is None or (value.isascii() and value.isdigit() and len(value) <= MOST_DIGITS):
            continue
        shown = value if len(value) <= LONGEST_QUOTE else f"{value[:LONGEST_QUOTE]}..."
        raise UsageError(f"{name}={shown}: not a whole number; set it to one, or unset it")
