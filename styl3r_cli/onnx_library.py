"""onnxruntime, imported whole or not at all."""

from __future__ import annotations

import os
from importlib import import_module
from threading import Lock
from types import ModuleType

from styl3r_cli import memory
from styl3r_cli.errors import ModelError, OutOfMemoryError

# Of what the package uses, names from each part of onnxruntime that can fail to load by itself.
NEEDED = (
    "InferenceSession",
    "RunOptions",
    "SessionOptions",
    "disable_telemetry_events",
    "set_default_logger_severity",
)
DAMAGED = "onnxruntime is damaged ({}); reinstall it: pip install --force-reinstall onnxruntime"

# From 1.29 on, onnxruntime tells Microsoft what it runs, keeps a device's identifier in the user's
# cache for that, and a file in TMPDIR. It asks for this variable once, while it loads.
NO_TELEMETRY = "ORT_DISABLE_TELEMETRY"

_importing = Lock()


def onnxruntime(part: str = "") -> ModuleType:
    """The module, complete and telling nobody anything, or one of its parts.

    The two graphs of a model load in two threads. Where Python imports a module in both at once
    and that fails in one, the other is given what there was of it; hence one after the other.

    Args:
        part: a module in it, such as "quantization".

    Raises:
        OutOfMemoryError: it does not fit into memory.
        ModelError: it is missing or damaged.
    """
    with _importing:
        os.environ[NO_TELEMETRY] = "1"
        module = _imported("onnxruntime")
        missing = [name for name in NEEDED if not hasattr(module, name)]
        if missing:
            raise ModelError(DAMAGED.format(f"it has no {missing[0]}"))
        module.disable_telemetry_events()  # on Windows, where nothing asks for the variable
        return _imported(f"onnxruntime.{part}") if part else module


def _imported(name: str) -> ModuleType:
    try:
        return import_module(name)
    except Exception as error:  # loaders, and the module's own checks, raise what they like
        if memory.ended(error):
            raise OutOfMemoryError("out of memory: onnxruntime does not fit into it") from error
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise ModelError(DAMAGED.format(reason)) from error
