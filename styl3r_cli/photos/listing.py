"""Lists of files that other programs write: one name a line, or ended by NUL."""

from __future__ import annotations

import codecs
import os

from styl3r_cli.errors import InputError
from styl3r_cli.incoming import Kind

# Bytes: the names of a million photos, of which 8 are used.
NAMES = Kind("a list of photos", 64 << 20)


def parse_list(data: bytes, null: bool = False) -> list[str]:
    """The names in a list such as `find` prints, in its order, exactly as they are.

    Args:
        data: what came through the pipe.
        null: whether names end in NUL (`find -print0`) instead of line breaks, which names may
            contain.

    Raises:
        InputError: there is no name in it.
    """
    if not null:
        data = _unmarked(data)
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


def _unmarked(data: bytes) -> bytes:
    """The names alone, where Windows marked a text's beginning (PowerShell's is UTF-16)."""
    if data.startswith(codecs.BOM_UTF16_LE) and b"\0" in data:
        try:
            return os.fsencode(data.decode("utf-16"))
        except UnicodeError:
            return data
    return data.removeprefix(codecs.BOM_UTF8)
