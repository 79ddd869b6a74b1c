"""Scene files: one module a format behind one small registry.

A format is a module with `encode(gaussians, metadata) -> Encoded` and
`decode(data, name) -> Scene`, and one line in `MODULES`.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from types import ModuleType

from styl3r_cli.errors import InputError, UsageError
from styl3r_cli.files import atomic_write
from styl3r_cli.formats.scene import Encoded, Scene
from styl3r_cli.gaussians import Gaussians

__all__ = ["Encoded", "Scene", "encode_scene", "read_scene", "scene_suffix", "write_scene"]

MODULES = {".ply": "styl3r_cli.formats.ply"}
MAGIC = {b"ply": ".ply"}  # how a scene that comes through a pipe is recognised


def scene_suffix(path: Path) -> str:
    """The path's suffix in lower case, if a format has it: to fail before the work, not after.

    Raises:
        UsageError: no format has this suffix.
    """
    suffix = path.suffix.lower()
    if suffix not in MODULES:
        raise UsageError(
            f"{path}: unknown scene format '{path.suffix}'; use one of {', '.join(MODULES)}"
        )
    return suffix


def read_scene(source: Path | bytes) -> Scene:
    """Read a scene from a file or from the bytes of one.

    Raises:
        InputError: the file is missing or broken, or the bytes are of no known format.
        UsageError: no format has the file's suffix.
    """
    if isinstance(source, bytes):
        for magic, suffix in MAGIC.items():
            if source.startswith(magic):
                return _module(suffix).decode(source, "-")
        raise InputError(f"-: not a scene in a known format ({', '.join(MODULES)})")
    suffix = scene_suffix(source)
    try:
        data = source.read_bytes()
    except OSError as error:
        raise InputError(f"{source}: cannot be read: {error.strerror or error}") from error
    return _module(suffix).decode(data, str(source))


def encode_scene(
    gaussians: Gaussians, metadata: dict[str, str] | None = None, suffix: str = ".ply"
) -> Encoded:
    """A scene file's bytes, the same for the same scene, and notes on what was repaired."""
    return _module(suffix).encode(gaussians, metadata or {})


def write_scene(
    path: Path, gaussians: Gaussians, metadata: dict[str, str] | None = None
) -> Encoded:
    """Write a scene; the suffix chooses the format, and the file appears whole or not at all.

    Args:
        path: where to write.
        gaussians: the scene.
        metadata: text that goes along, where the format has a place for it.

    Returns:
        What was written: its bytes, the number of Gaussians, and notes on repairs.

    Raises:
        OutputError: the file cannot be written.
        UsageError: no format has the file's suffix.
    """
    encoded = encode_scene(gaussians, metadata, scene_suffix(path))
    with atomic_write(path) as temporary:
        temporary.write_bytes(encoded.data)
    return encoded


def _module(suffix: str) -> ModuleType:
    return import_module(MODULES[suffix])
