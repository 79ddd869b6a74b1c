"""Binary glTF 2.0: arrays and a JSON description in one file.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, section 4 (GLB).
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.errors import InputError

MAGIC, VERSION = 0x46546C67, 2
HEAD, CHUNK = struct.Struct("<III"), struct.Struct("<II")
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
ALIGNMENT = 4  # of chunks and of arrays
ARRAY_BUFFER = 34962
COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
CODES = {np.dtype(kind): code for code, kind in COMPONENTS.items()}
KINDS = {width: kind for kind, width in WIDTHS.items()}


class Arrays:
    """The binary part of a file that is being written: arrays, and the JSON that describes them."""

    def __init__(self) -> None:
        self.accessors: list[dict[str, Any]] = []
        self.views: list[dict[str, Any]] = []
        self._parts: list[bytes] = []
        self._size = 0

    def add(self, array: NDArray[Any], *, normalised: bool = False, bounds: bool = False) -> int:
        """Append (G,) or (G, 2..4) values; their accessor's index."""
        array = np.ascontiguousarray(array)
        accessor: dict[str, Any] = {
            "bufferView": len(self.views),
            "componentType": CODES[array.dtype],
            "count": len(array),
            "type": KINDS[array.size // max(len(array), 1) if array.ndim > 1 else 1],
        }
        if normalised:
            accessor["normalized"] = True
        if bounds:
            accessor["min"], accessor["max"] = (
                array.min(axis=0).tolist(),
                array.max(axis=0).tolist(),
            )
        data = array.tobytes()
        view = {"buffer": 0, "byteOffset": self._size, "byteLength": len(data)}
        self.views.append(view | {"target": ARRAY_BUFFER})
        self.accessors.append(accessor)
        self._parts.append(data + bytes(-len(data) % ALIGNMENT))
        self._size += len(self._parts[-1])
        return len(self.accessors) - 1

    def bundle(self, document: dict[str, Any]) -> bytes:
        """The whole file; the document gets its buffers, views and accessors."""
        if self._size:
            document |= {
                "buffers": [{"byteLength": self._size}],
                "bufferViews": self.views,
                "accessors": self.accessors,
            }
        text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % ALIGNMENT)
        chunks = [CHUNK.pack(len(text), JSON_CHUNK), text]
        if self._size:
            chunks += [CHUNK.pack(self._size, BINARY_CHUNK), *self._parts]
        body = b"".join(chunks)
        return HEAD.pack(MAGIC, VERSION, HEAD.size + len(body)) + body


def split(data: bytes, name: str) -> tuple[dict[str, Any], memoryview]:
    """The JSON document and the binary part.

    Raises:
        InputError: it is no binary glTF 2.0, or damaged.
    """
    if len(data) < HEAD.size or HEAD.unpack_from(data)[0] != MAGIC:
        raise InputError(f"{name}: not a .glb file" if data else f"{name}: the file is empty")
    _, version, length = HEAD.unpack_from(data)
    if version != VERSION:
        raise InputError(f"{name}: glTF version {version}; version {VERSION} can be read")
    if length > len(data):
        raise InputError(f"{name}: cut off: {len(data)} of {length} bytes are there")
    chunks: dict[int, memoryview] = {}
    place, view = HEAD.size, memoryview(data)
    while place + CHUNK.size <= length:
        size, kind = CHUNK.unpack_from(data, place)
        place += CHUNK.size
        if place + size > length:
            raise InputError(f"{name}: damaged: a part ends after the file does")
        chunks.setdefault(kind, view[place : place + size])
        place += size
    try:
        document = json.loads(bytes(chunks[JSON_CHUNK]))
    except (KeyError, ValueError, RecursionError) as error:
        raise InputError(f"{name}: damaged: it has no JSON that can be read") from error
    if not isinstance(document, dict):
        raise InputError(f"{name}: damaged: its JSON is no glTF")
    return document, chunks.get(BINARY_CHUNK, memoryview(b""))


def read_array(document: dict[str, Any], binary: memoryview, index: object) -> NDArray[Any]:
    """(G, width) values of an accessor, normalised integers as floats.

    Raises:
        ValueError, KeyError, TypeError, IndexError: the file is damaged, or keeps the array in a
            way that scenes do not use (sparse, compressed, in another file).
    """
    accessor = _entry(document["accessors"], index)
    view = _entry(document["bufferViews"], accessor["bufferView"])
    if view["buffer"] != 0 or "uri" in document["buffers"][0] or "sparse" in accessor:
        raise ValueError("its data are not in the file itself, or sparse")
    kind, width = np.dtype(COMPONENTS[accessor["componentType"]]), WIDTHS[accessor["type"]]
    count, row = _whole(accessor["count"]), kind.itemsize * width
    start = _whole(accessor.get("byteOffset", 0))
    step = _whole(view.get("byteStride", row))
    offset, length = _whole(view.get("byteOffset", 0)), _whole(view["byteLength"])
    if step < row or offset + length > len(binary):
        raise ValueError("a part of its data ends after the file does")
    if count and start + (count - 1) * step + row > length:
        raise ValueError("an array ends after its data do")
    if not count:
        return np.zeros((0, width), np.float32)
    bytes_ = np.frombuffer(binary, np.uint8, length - start, offset + start)
    rows = np.lib.stride_tricks.as_strided(bytes_, (count, row), (step, 1))
    values = np.ascontiguousarray(rows).view(kind)
    if not accessor.get("normalized", False):
        return values
    return np.maximum(values / np.float32(np.iinfo(kind).max), -1)


def _entry(entries: list[Any], index: object) -> Any:
    return entries[_whole(index)]


def _whole(value: object) -> int:
    if type(value) is not int or value < 0:
        raise ValueError(f"'{str(value)[:20]}' is no size or place")
    return value
