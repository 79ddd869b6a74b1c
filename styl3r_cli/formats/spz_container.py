"""The .spz container: a header and five blocks of bytes, in one gzip or several zstd streams."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.errors import InputError
from styl3r_cli.formats.values import check_count

MAGIC = 0x5053474E  # "NGSP" in the file's byte order
HEADER = struct.Struct("<IIIBBBB")  # magic, version, count, SH degree, fraction bits, flags, 0
HEADER_4 = struct.Struct(
    "<IIIBBBBI12x"
)  # the same with the number of streams, and the table's place
ENTRY = struct.Struct("<QQ")  # of the table: compressed and plain size
GZIP = 16 + zlib.MAX_WBITS  # zlib's way to say that gzip's header is expected
VERSIONS = (2, 3, 4)
MOST_DEGREE = 4
MOST_FRACTION_BITS = 30


@dataclass(frozen=True)
class Packed:
    """What the streams hold; all blocks are bytes.

    Attributes:
        version: of the format.
        count: Gaussians.
        degree: of the spherical harmonics that are there (and not kept).
        fraction_bits: of a coordinate.
        means: 9 bytes a Gaussian.
        opacities: 1 byte.
        colours: 3 bytes.
        scales: 3 bytes.
        rotations: 3 bytes in version 2, else 4.
    """

    version: int
    count: int
    degree: int
    fraction_bits: int
    means: NDArray[np.uint8]
    opacities: NDArray[np.uint8]
    colours: NDArray[np.uint8]
    scales: NDArray[np.uint8]
    rotations: NDArray[np.uint8]


def unpack(data: bytes, name: str) -> Packed:
    """Decompress a file, never to more than its number of Gaussians takes.

    Raises:
        InputError: it is no .spz, of another version, or damaged.
    """
    if data[:2] == b"\x1f\x8b":
        return _unpack_gzip(data, name)
    if data[:4] == struct.pack("<I", MAGIC):
        return _unpack_zstd(data, name)
    raise InputError(f"{name}: not an .spz file" if data else f"{name}: the file is empty")


def _unpack_gzip(data: bytes, name: str) -> Packed:
    stream = zlib.decompressobj(GZIP)
    try:
        head = stream.decompress(data, HEADER.size)
        if len(head) < HEADER.size or head[:4] != struct.pack("<I", MAGIC):
            raise InputError(f"{name}: gzip, but not an .spz file")
        fields = _checked(HEADER.unpack(head), len(data), name)
        sizes = _sizes(fields[0], fields[1])
        body = stream.decompress(stream.unconsumed_tail, max(sum(sizes), 1))
    except zlib.error as error:
        raise InputError(f"{name}: damaged: {error}") from error
    if len(body) < sum(sizes):
        raise InputError(f"{name}: cut off: {len(body)} of {sum(sizes)} bytes are there")
    ends = np.cumsum(sizes)
    blocks = [body[end - size : end] for end, size in zip(ends, sizes, strict=True)]
    return _packed(fields, blocks)


def _unpack_zstd(data: bytes, name: str) -> Packed:
    if len(data) < HEADER_4.size:
        raise InputError(f"{name}: cut off: {len(data)} bytes")
    *head, streams, table = HEADER_4.unpack_from(data)
    fields = _checked((*head, 0), len(data), name)
    sizes = _sizes(fields[0], fields[1])
    if streams < len(sizes) or table + streams * ENTRY.size > len(data):
        raise InputError(f"{name}: damaged: its table of streams is not there")
    place = table + streams * ENTRY.size
    blocks = []
    for index, size in enumerate(sizes):
        packed, plain = ENTRY.unpack_from(data, table + index * ENTRY.size)
        if plain != size or place + packed > len(data):
            raise InputError(f"{name}: cut off or damaged: stream {index + 1} of {streams}")
        blocks.append(_from_zstd(data[place : place + packed], size, name))
        place += packed
    return _packed(fields, blocks)


def _from_zstd(data: bytes, size: int, name: str) -> bytes:
    """Exactly `size` bytes."""
    import zstandard as zstd

    try:
        block = zstd.ZstdDecompressor().stream_reader(data).read(size) if size else b""
    except zstd.ZstdError as error:
        raise InputError(f"{name}: damaged: {error}") from error
    if len(block) < size:
        raise InputError(f"{name}: cut off: {len(block)} of a stream's {size} bytes are there")
    return block


def _checked(fields: tuple[int, ...], size: int, name: str) -> tuple[int, int, int, int]:
    """(version, count, degree, fraction bits) of a header that can be true."""
    _, version, count, degree, fraction_bits, *_ = fields
    if version not in VERSIONS:
        known = ", ".join(map(str, VERSIONS))
        raise InputError(f"{name}: .spz version {version}; versions {known} can be read")
    if degree > MOST_DEGREE or fraction_bits > MOST_FRACTION_BITS:
        raise InputError(f"{name}: damaged: its header makes no sense")
    check_count(count, size, name)
    return version, count, degree, fraction_bits


def _sizes(version: int, count: int) -> list[int]:
    """Bytes of means, opacities, colours, scales, rotations."""
    return [count * size for size in (9, 1, 3, 3, 3 if version == 2 else 4)]


def _packed(fields: tuple[int, int, int, int], blocks: list[bytes]) -> Packed:
    return Packed(*fields, *(np.frombuffer(block, np.uint8) for block in blocks))
