"""Compiled kernels on disk: a file for each, which says itself what it was compiled from."""

from __future__ import annotations

import hashlib
import pickle
from pathlib import Path
from typing import Any

from numba.core.caching import IndexDataCacheFile

from styl3r_cli.files import atomic_write

DIGEST_BYTES = hashlib.sha256().digest_size  # at the start of a file: of what follows
NAME_DIGITS = 16  # of a digest: two of a kernel's few kinds of arguments never share it


class KeptCode(IndexDataCacheFile):  # type: ignore[misc]  # numba has no types
    """What numba keeps of one kernel, without numba's index of it.

    numba writes the index first, then the code that it names. Whoever is killed between the two,
    or finds the disk full, leaves the new index with the code of earlier sources, and that is
    what every later run would draw with. Two processes that compile at once overwrite each other's
    index, or give one name to two codes.
    """

    def save(self, key: Any, data: Any) -> None:
        """Keep the code of these types of arguments, in place of what there was.

        Raises:
            OutputError: there is no place.
        """
        kept = self._dump((self._origin(key), data))
        with atomic_write(self._path(key)) as file:
            file.write_bytes(hashlib.sha256(kept).digest() + kept)

    def load(self, key: Any) -> Any:
        """The code, or None where there is none of these sources and this processor, or no longer.

        Raises:
            Exception: of any kind, where the file is not one that `save` wrote.
        """
        try:
            stored = self._path(key).read_bytes()
        except FileNotFoundError:
            return None
        kept = stored[DIGEST_BYTES:]
        if hashlib.sha256(kept).digest() != stored[:DIGEST_BYTES]:  # machine code would crash
            return None
        origin, data = pickle.loads(kept)
        return data if origin == self._origin(key) else None

    def _origin(self, key: Any) -> tuple[Any, ...]:
        return self._version, self._source_stamp, key

    def _path(self, key: Any) -> Path:
        """Where code of these arguments is, whatever it was compiled from: later replaces it."""
        types, processor, _ = key
        digest = hashlib.sha256(repr((types, processor)).encode()).hexdigest()[:NAME_DIGITS]
        return Path(self._data_path(self._data_name_pattern.format(number=int(digest, 16))))
