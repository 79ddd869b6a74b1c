"""Torch checkpoint files read as data: whatever they pickle, nothing in them is ever called."""

from __future__ import annotations

import pickle
import struct
import sys
import warnings
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from styl3r_cli.errors import InputError, shortened

# What torch calls the storages of each element type.
STORAGES = {
    "DoubleStorage": torch.float64,
    "FloatStorage": torch.float32,
    "HalfStorage": torch.float16,
    "BFloat16Storage": torch.bfloat16,
    "LongStorage": torch.int64,
    "IntStorage": torch.int32,
    "ShortStorage": torch.int16,
    "CharStorage": torch.int8,
    "ByteStorage": torch.uint8,
    "BoolStorage": torch.bool,
}
# What a tensor's or a parameter's pickle calls, and ours for it.
TENSOR_MODULE = "torch._utils"
ORDER = sys.byteorder.encode()  # as torch writes it


class Placeholder:
    """Stands for an object of a foreign class; it takes every state and does nothing with it."""

    def __init__(self, *_: object, **__: object) -> None: ...

    def __setstate__(self, _: object) -> None: ...

    def __setitem__(self, _: object, __: object) -> None: ...

    def __call__(self, *_: object, **__: object) -> Placeholder:
        """What a placeholder for a function gives."""
        return self

    def append(self, _: object) -> None:
        """Ignore an element that the pickle adds."""

    def extend(self, _: object) -> None:
        """Ignore elements that the pickle adds."""

    def add(self, _: object) -> None:
        """Ignore an element that the pickle adds."""


class InertUnpickler(pickle._Unpickler):
    """Builds tensors, containers and plain values; every other class becomes a placeholder.

    The pickle module's reader in Python: the one in C makes room for as many remembered objects as
    a pickle claims to have, and a claim of five bytes takes gigabytes. These pickles are small.
    """

    def __init__(self, archive: zipfile.ZipFile, root: str) -> None:
        super().__init__(archive.open(f"{root}data.pkl"))
        self.archive, self.root = archive, root
        self.storages: dict[str, Tensor] = {}

    def find_class(self, module: str, name: str) -> Any:
        """What a name in the pickle stands for; never the thing itself, but for OrderedDict."""
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        if module == "torch" and name in STORAGES:
            return STORAGES[name]
        rebuild = REBUILD.get(name) if module == TENSOR_MODULE else None
        if rebuild is not None:
            return rebuild
        return type(name.rpartition(".")[2], (Placeholder,), {"__module__": module})

    def persistent_load(self, pid: Any) -> Tensor:
        """A storage as a flat tensor; several tensors may share it."""
        match pid:
            case ("storage", torch.dtype() as dtype, str(key), str(), int(count)):
                pass
            case _:
                raise pickle.UnpicklingError("a storage of an unknown kind")
        if key not in self.storages:
            data = bytearray(self.archive.read(f"{self.root}data/{key}"))
            flat = torch.frombuffer(data, dtype=dtype) if data else torch.empty(0, dtype=dtype)
            if len(flat) != count:
                raise pickle.UnpicklingError(f"storage {key} has {len(flat)} of {count} values")
            self.storages[key] = flat
        return self.storages[key]


def _read_bytearray(reader: Any) -> None:
    """An array of as many bytes as there are; Python's own makes room for as many as claimed."""
    (claimed,) = struct.unpack("<Q", reader.read(8))
    data = reader.read(claimed)
    if len(data) < claimed:
        raise EOFError("pickle exhausted before its end")
    reader.append(bytearray(data))


InertUnpickler.dispatch = pickle._Unpickler.dispatch | {pickle.BYTEARRAY8[0]: _read_bytearray}


def _tensor(storage: Tensor, offset: int, size: Any, stride: Any, *_: object) -> Tensor:
    """A view into a storage; torch makes sure that it lies inside."""
    return storage.as_strided(tuple(size), tuple(stride), int(offset))


def _parameter(data: Tensor, *_: object) -> Tensor:
    """A parameter's values."""
    return data


REBUILD: dict[str, Callable[..., Tensor]] = {
    "_rebuild_tensor": _tensor,
    "_rebuild_tensor_v2": _tensor,
    "_rebuild_parameter": _parameter,
    "_rebuild_parameter_with_state": _parameter,
}


def read_checkpoint(path: Path) -> Any:
    """The contents of a `torch.save` file, without executing anything in it.

    Files of plain tensors and values are mapped into memory by torch's own restricted reader.
    Where that refuses (training frameworks pickle hyper parameters and callbacks beside the
    weights), foreign objects are replaced by placeholders.

    Raises:
        InputError: the file is missing, or no such checkpoint.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; name a checkpoint")
    zipped = _is_zipped(path)
    if zipped:
        _check_archive(path)
    try:
        with warnings.catch_warnings():  # about pickles that the second reader may well read
            warnings.simplefilter("ignore")
            return torch.load(path, map_location="cpu", weights_only=True, mmap=zipped)
    except Exception as error:
        if not zipped:
            message = f"{path}: not a torch checkpoint, or one from before torch 1.6"
            raise InputError(f"{message}; name a file that torch.save wrote") from error
    try:
        with zipfile.ZipFile(path) as archive:
            pickles = [
                n for n in archive.namelist() if n.count("/") == 1 and n.endswith("/data.pkl")
            ]
            if len(pickles) != 1:
                raise pickle.UnpicklingError("it holds no pickled data")
            return InertUnpickler(archive, pickles[0].removesuffix("data.pkl")).load()
    except Exception as error:  # a damaged pickle can raise anything
        raise _damaged(path, error) from error


def _check_archive(path: Path) -> None:
    """Make sure that an archive's parts are stored as torch stores them, and undamaged.

    Torch reads parts in place: it takes compressed ones for values, and checks no checksum. What is
    not compressed, and has a place of its own in the file, takes no more memory than the file.

    Raises:
        InputError: they are not.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            parts = archive.infolist()
            if any(part.compress_type != zipfile.ZIP_STORED for part in parts):
                raise zipfile.BadZipFile("its parts are compressed")
            if sum(part.file_size for part in parts) > path.stat().st_size:
                raise zipfile.BadZipFile("its parts are larger than the file")
            if any(p.filename.endswith("/byteorder") and archive.read(p) != ORDER for p in parts):
                raise zipfile.BadZipFile("of a machine with another order of bytes")
            if damaged := archive.testzip():
                raise zipfile.BadZipFile(f"the checksum of {damaged} differs")
    except Exception as error:  # zipfile raises struct.error, NotImplementedError and others, too
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> InputError:
    message = f"{path}: damaged, or not a torch checkpoint ({shortened(str(error))})"
    return InputError(f"{message}; download it again")


def _is_zipped(path: Path) -> bool:
    """Whether it is of torch.save's format since 2020."""
    try:
        return zipfile.is_zipfile(path)
    except (zipfile.BadZipFile, OSError):  # raised for ends that speak of several disks
        return False
