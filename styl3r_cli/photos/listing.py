"""Lists of files that other programs write: one name a line, or ended by NUL."""

from __future__ import annotations

import os

from styl3r_cli.errors import InputError


def parse_list(data: bytes, null: bool = False) -> list[str]:
    """The names in a list such as `find` prints, in its order, exactly as they are.

    Args:
        data: what came through the pipe.
        null: whether names end in NUL (`find -print0`) instead of line breaks, which names may
            contain.

    Raises:
        InputError: there is no name in it.
    """
    if null:
        names = data.split(b"\0")
    else:
        names = [line.removesuffix(b"\r") for line in data.split(b"\n")]
    if not null and b"\0" in data:
        raise InputError("-: the names on standard input end in NUL; add -0 to read them")
    found = [os.fsdecode(name) for name in names if name]
    if not found:
        raise InputError("-: no photo names on standard input; did the program before it find any?")
    return found
