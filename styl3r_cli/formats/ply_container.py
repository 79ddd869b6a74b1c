"""The PLY container: header, and one element's rows in any of the three encodings."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain, islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.errors import InputError

SCALARS = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
VERSION = "1.0"  # there has been no other
MAGIC = (b"ply\n", b"ply\r")
END = b"end_header"
MOST_ROWS = 1 << 60  # no file has more; numbers of thousands of digits make long messages
LONGEST_QUOTE = 80  # characters of a damaged file in a message
LARGEST_TEXT = 1 << 30  # bytes of ASCII rows: read in 7 s, with as much memory again
LONGEST_NUMBER = 1000  # bytes, spaces included; printf's longest double has 330
MOST_EMPTY_LINES = 1000  # more than there are rows
LONGEST_HEADER = 1 << 20  # a file without an end of the header is not searched for gigabytes


@dataclass
class Element:
    """One element of the header: its properties' numpy types, or None for a list."""

    name: str
    count: int
    names: list[str] = field(default_factory=list)
    types: list[str | None] = field(default_factory=list)


@dataclass(frozen=True)
class Table:
    """The rows of an element.

    Attributes:
        names: of its properties.
        rows: a structured array, or one float64 column a property.
        comments: of the header.
        surplus: whether more follows than the header tells of, as far as that can be seen.
    """

    names: list[str]
    rows: NDArray[Any]
    comments: list[str]
    surplus: bool

    def column(self, name: str) -> NDArray[Any]:
        """One property of all rows."""
        if self.rows.dtype.names:
            return self.rows[name]
        return self.rows[:, self.names.index(name)]


def read_element(data: bytes, name: str, wanted: str = "vertex") -> Table:
    """Find and read one element of a PLY file.

    Args:
        data: the whole file.
        name: what to call it in messages.
        wanted: the element.

    Raises:
        InputError: it is no PLY file, has no such element, or its header or its length is wrong.
    """
    lines, body = _split(data, name)
    order, elements, comments = _parse_header(lines, name)
    before: list[Element] = []
    if sum(element.name == wanted for element in elements) > 1:
        raise InputError(f"{name}: the PLY has several '{wanted}' elements; which one is meant?")
    for element in elements:
        if element.name == wanted:
            break
        before.append(element)
    else:
        raise InputError(f"{name}: the PLY has no '{wanted}' element")
    if None in element.types:
        raise InputError(f"{name}: '{wanted}' has lists, which 3D Gaussians do not have")
    if len(set(element.names)) < len(element.names):
        raise InputError(f"{name}: the PLY header names a property of '{wanted}' twice")
    if not element.names:
        raise InputError(f"{name}: the PLY header names no property of '{wanted}'")
    read = _read_binary if order else _read_ascii
    rows, surplus = read(data, body, order, before, element, name)
    return Table(element.names, rows, comments, surplus and element is elements[-1])


def header_is_whole(begun: bytes, name: str) -> bool:
    """Whether the first bytes of a file have a PLY's header to its end.

    Raises:
        InputError: they are of no PLY file, or the header is longer than any that is read.
    """
    if len(begun) >= len(MAGIC[0]) and begun[: len(MAGIC[0])] not in MAGIC:
        raise InputError(f"{name}: not a PLY file")
    end = begun.find(b"\n" + END, 0, LONGEST_HEADER)
    if end >= 0 and begun.find(b"\n", end + 1, LONGEST_HEADER) >= 0:
        return True
    if len(begun) >= LONGEST_HEADER:
        size = f"{LONGEST_HEADER >> 20} MB"
        raise InputError(f"{name}: the PLY header does not end within {size}; no more is read")
    return False


def _split(data: bytes, name: str) -> tuple[list[str], int]:
    """The header's lines, and where the body begins."""
    if data[:4] not in MAGIC:
        raise InputError(f"{name}: not a PLY file" if data else f"{name}: the file is empty")
    if not header_is_whole(data, name):
        raise InputError(f"{name}: the PLY header has no end; is the file cut off?")
    end = data.find(b"\n" + END)
    line_end = data.find(b"\n", end + 1)
    text = data[:end].decode("utf-8", errors="replace")
    return [line.removesuffix("\r") for line in text.split("\n")], line_end + 1


def _parse_header(lines: list[str], name: str) -> tuple[str, list[Element], list[str]]:
    order: str | None = None
    elements: list[Element] = []
    comments: list[str] = []
    for line in lines[1:]:
        words = line.split()
        try:
            match words:
                case ["comment" | "obj_info", *_]:
                    comments.append(line.lstrip().split(" ", 1)[1] if " " in line.strip() else "")
                case ["format", encoding, version] if order is None:
                    order = BYTE_ORDERS[encoding]
                    if version != VERSION:
                        what = f"PLY of version {version[:LONGEST_QUOTE]}"
                        raise InputError(f"{name}: {what}; only {VERSION} can be read")
                case ["element", element, count]:
                    elements.append(Element(element, int(count)))
                    if not 0 <= int(count) <= MOST_ROWS:
                        raise ValueError(count)
                case ["property", "list", length, item, label]:
                    _ = SCALARS[length], SCALARS[item]
                    elements[-1].names.append(label)
                    elements[-1].types.append(None)
                case ["property", scalar, label]:
                    elements[-1].names.append(label)
                    elements[-1].types.append(SCALARS[scalar])
                case []:
                    pass
                case _:
                    raise ValueError(line)
        except (KeyError, ValueError, IndexError) as error:
            what = line.strip()[:LONGEST_QUOTE]
            raise InputError(f"{name}: bad line in the PLY header: '{what}'") from error
    if order is None:
        raise InputError(f"{name}: the PLY header does not say its format")
    return order, elements, comments


def _read_binary(
    data: bytes, body: int, order: str, before: list[Element], wanted: Element, name: str
) -> tuple[NDArray[Any], bool]:
    for element in before:
        if None in element.types:
            raise InputError(f"{name}: lists before the vertices; save it with the vertices first")
        body += element.count * sum(np.dtype(kind).itemsize for kind in element.types)
    row = np.dtype([(n, order + str(t)) for n, t in zip(wanted.names, wanted.types, strict=True)])
    whole = max(len(data) - body, 0) // row.itemsize
    if whole < wanted.count or body > len(data):
        raise InputError(f"{name}: cut off: {whole} of {wanted.count} {_rows(wanted)} are there")
    rows = np.frombuffer(data, row, wanted.count, body)
    return rows, body + rows.nbytes < len(data)


def _read_ascii(
    data: bytes, body: int, order: str, before: list[Element], wanted: Element, name: str
) -> tuple[NDArray[Any], bool]:
    """Row by row: text takes ten times its size in memory where it is split all at once."""
    if len(data) - body > LARGEST_TEXT:
        size = f"{(len(data) - body) // 10**6} MB of text"
        raise InputError(f"{name}: {size} is more than is read; save it as a binary PLY")
    width = len(wanted.names)
    first = min(sum(element.count for element in before), MOST_ROWS)
    lines = _text_rows(data, body, width, name)
    rows = islice(lines, first, first + wanted.count)
    start = next(rows, None)
    if start is None:
        table = np.zeros((0, width))
    else:
        try:
            table = np.loadtxt(chain([start], rows), np.float64, comments=None, ndmin=2)
        except ValueError as error:
            what = str(error).split(";")[0][:LONGEST_QUOTE]
            raise InputError(
                f"{name}: a row is not the header's {width} numbers: {what}"
            ) from error
    if table.shape[1] != width:
        has = f"it has {table.shape[1]}"
        raise InputError(f"{name}: a row is not the header's {width} numbers: {has}")
    if len(table) < wanted.count:
        there = f"{len(table)} of {wanted.count} {_rows(wanted)} are there"
        raise InputError(f"{name}: cut off: {there}")
    return table, next(lines, None) is not None


def _text_rows(data: bytes, body: int, width: int, name: str) -> Iterator[bytes]:
    """The lines with something in them, of the lengths that rows can have."""
    lines = io.BytesIO(data)  # shares the bytes
    lines.seek(body)
    longest = LONGEST_NUMBER * width
    surplus = 0  # of empty lines over rows
    for line in lines:
        empty = not line.strip()
        surplus += 1 if empty else -1
        if surplus > MOST_EMPTY_LINES:
            raise InputError(f"{name}: more empty lines than rows; save it as a binary PLY")
        if not empty:
            if len(line) > longest:
                raise InputError(f"{name}: a row of {len(line)} bytes is not {width} numbers")
            yield line


def _rows(element: Element) -> str:
    return "Gaussians" if element.name == "vertex" else f"rows of '{element.name}'"
