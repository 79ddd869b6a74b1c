"""The .sog container: meta.json and pictures in a zip, each checked before it is believed."""

from __future__ import annotations

import io
import json
import warnings
import zipfile
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.errors import InputError
from styl3r_cli.formats.codebook import SIZE
from styl3r_cli.formats.values import check_count

KEY = "styl3r"  # of meta.json, for the metadata that this program writes along
META = "meta.json"
# Lossless WebP hardly shrinks in a zip, and meta.json not by more than this.
MOST_INFLATED = 1 << 24
SLACK = 1 << 16  # pixels that a picture may have beside those of Gaussians (at most as many again)


@dataclass(frozen=True)
class Archive:
    """An opened bundle.

    Attributes:
        files: the zip.
        meta: meta.json.
        count: Gaussians.
        name: what to call the file in messages.
    """

    files: zipfile.ZipFile
    meta: dict[str, Any]
    count: int
    name: str

    def picture(self, key: str, index: int) -> NDArray[np.uint8]:
        """(count, 4) pixels of one of a property's pictures.

        Raises:
            InputError: it is not there, no picture, or too small or too large.
        """
        from PIL import Image
        from PIL.Image import DecompressionBombError as BombError

        try:
            file = self.meta[key]["files"][index]
            data = read_member(self.files, file, self.name)
        except (KeyError, IndexError, TypeError) as error:
            raise InputError(f"{self.name}: damaged: picture {index} of '{key}' missing") from error
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", Image.DecompressionBombWarning)
                image = Image.open(io.BytesIO(data))
            pixels = image.width * image.height
            if not self.count <= pixels <= 2 * self.count + SLACK:
                raise InputError(
                    f"{self.name}: damaged: {file} has {pixels} pixels for {self.count} Gaussians"
                )
            return np.asarray(image.convert("RGBA")).reshape(-1, 4)[: self.count]
        except (OSError, ValueError, SyntaxError, MemoryError, Warning, BombError) as error:
            raise InputError(f"{self.name}: damaged: {file} cannot be read as a picture") from error

    def codebook(self, key: str) -> NDArray[np.float64]:
        """(256,) the numbers that a property's bytes stand for."""
        return self._numbers(self.meta.get(key), "codebook", key, SIZE)

    def vector(self, key: str) -> NDArray[np.float64]:
        """(3,) one end of the range of the means."""
        return self._numbers(self.meta.get("means"), key, "means", 3)

    def metadata(self) -> dict[str, str]:
        """The text that styl3r wrote along."""
        own = self.meta.get(KEY)
        if not isinstance(own, dict):
            return {}
        return {key: value for key, value in own.items() if isinstance(value, str)}

    def _numbers(self, part: object, key: str, what: str, count: int) -> NDArray[np.float64]:
        values = part.get(key) if isinstance(part, dict) else None
        try:
            if isinstance(values, list) and len(values) == count:
                return np.array([float(value) for value in values])
        except (TypeError, ValueError, OverflowError):
            pass
        raise InputError(f"{self.name}: damaged: '{key}' of '{what}' is not {count} numbers")


def open_archive(data: bytes, name: str) -> Archive:
    """Open a bundle and read its meta.json.

    Raises:
        InputError: it is no SOG bundle of version 2, or damaged.
    """
    try:
        files = zipfile.ZipFile(io.BytesIO(data))
    except (zipfile.BadZipFile, ValueError, NotImplementedError, OSError) as error:
        what = "not a .sog file, or cut off" if data else "the file is empty"
        raise InputError(f"{name}: {what}") from error
    try:
        meta = json.loads(read_member(files, META, name))
    except KeyError as error:
        raise InputError(f"{name}: a zip without {META}, so not a .sog file") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name}: damaged: {META} is no JSON") from error
    if not isinstance(meta, dict) or meta.get("version") != 2:
        raise InputError(f"{name}: not SOG version 2; write it again with a current program")
    count = meta.get("count")
    if type(count) is not int:
        raise InputError(f"{name}: damaged: {META} does not say how many Gaussians there are")
    check_count(count, len(data), name)
    return Archive(files, meta, count, name)


def read_member(files: zipfile.ZipFile, file: str, name: str) -> bytes:
    """One file of the zip.

    Raises:
        KeyError: it is not there.
        InputError: it is damaged, encrypted, or inflates to more than a bundle of this size needs.
    """
    entry = files.getinfo(file)
    if entry.file_size > max(MOST_INFLATED, 2 * entry.compress_size):
        raise InputError(f"{name}: damaged: {file} inflates to {entry.file_size} bytes")
    try:
        return files.read(entry)
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, OSError, ValueError) as error:
        raise InputError(f"{name}: damaged: {file} in it cannot be unpacked") from error
