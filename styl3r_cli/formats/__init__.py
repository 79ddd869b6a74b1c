"""Scene files: one module a format behind one small registry.

A format is a module with `encode(gaussians, metadata) -> Encoded` and
`decode(data, name) -> Scene`, and one line in `MODULES`.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from types import ModuleType

from styl3r_cli.errors import InputError, UsageError
from styl3r_cli.files import atomic_write, read_file
from styl3r_cli.formats.scene import Encoded, Scene
from styl3r_cli.gaussians import Gaussians

__all__ = [
    "MODULES",
    "Encoded",
    "Scene",
    "encode_scene",
    "read_scene",
    "recognise",
    "scene_suffix",
    "write_scene",
]

MODULES = {
    ".ply": "styl3r_cli.formats.ply",
    ".compressed.ply": "styl3r_cli.formats.compressed_ply",
    ".splat": "styl3r_cli.formats.splat",
    ".spz": "styl3r_cli.formats.spz",
    ".sog": "styl3r_cli.formats.sog",
    ".glb": "styl3r_cli.formats.glb",
    ".points.glb": "styl3r_cli.formats.points_glb",
}
UNKNOWN = f"not a scene in a known format ({', '.join(MODULES)})"
# How a scene that comes through a pipe is recognised. A .splat has no such mark.
MAGIC = {
    b"ply": ".ply",
    b"\x1f\x8b": ".spz",
    b"NGSP": ".spz",
    b"PK\x03\x04": ".sog",
    b"glTF": ".glb",
}


def scene_suffix(path: Path) -> str:
    """The longest of the known suffixes that the path ends in, in lower case.

    Checked before the work, to fail early.

    Raises:
        UsageError: no format has this suffix.
    """
    name = path.name.lower()
    fitting = [suffix for suffix in MODULES if name.endswith(suffix) and name != suffix]
    if not fitting:
        raise UsageError(
            f"{path}: unknown scene format '{path.suffix}'; use one of {', '.join(MODULES)}"
        )
    return max(fitting, key=len)


def recognise(data: bytes) -> str | None:
    """The suffix of the format that bytes are of, as far as they show it."""
    for magic, suffix in MAGIC.items():
        if data.startswith(magic):
            return suffix
    return ".splat" if _module(".splat").recognised(data) else None


def begins(begun: bytes, suffix: str | None, name: str) -> bool:
    """Whether the first bytes of a file show a scene; False where they are too few to tell.

    Args:
        begun: the first bytes, 16 or more.
        suffix: the format, where it is known.
        name: what to call the file in messages.

    Raises:
        InputError: they are of no scene, or of one in another format.
    """
    magic = next((magic for magic in MAGIC if begun.startswith(magic)), None)
    if suffix is None and magic is None:
        likely: bool | None = _module(".splat").begins(begun)
        if likely is False:
            raise InputError(f"{name}: {UNKNOWN}")
        return bool(likely)
    if suffix not in (None, ".splat") and magic is None:
        _module(suffix).decode(begun, name)  # which says what is wrong
    if magic == b"ply":
        from styl3r_cli.formats.ply_container import header_is_whole

        return header_is_whole(begun, name)
    return True


def read_scene(source: Path | bytes, suffix: str | None = None, name: str = "-") -> Scene:
    """Read a scene from a file or from the bytes of one.

    Args:
        source: a path, whose suffix says its format, or the bytes of a file of any format.
        suffix: the format, where it is known better.
        name: what messages call bytes.

    Raises:
        InputError: the file is missing or broken, or the bytes are of no known format.
        UsageError: no format has the file's suffix.
    """
    if isinstance(source, bytes):
        suffix = suffix or recognise(source)
        if suffix is None:
            raise InputError(f"{name}: {UNKNOWN}")
        return _module(suffix).decode(source, name)
    suffix = suffix or scene_suffix(source)
    try:
        data = read_file(source)
    except OSError as error:
        raise InputError(f"{source}: cannot be read: {error.strerror or error}") from error
    return _module(suffix).decode(data, str(source))


def encode_scene(
    gaussians: Gaussians, metadata: dict[str, str] | None = None, suffix: str = ".ply"
) -> Encoded:
    """A scene file's bytes, the same for the same scene, and notes on what was repaired."""
    return _module(suffix).encode(gaussians, metadata or {})


def write_scene(
    path: Path,
    gaussians: Gaussians,
    metadata: dict[str, str] | None = None,
    suffix: str | None = None,
) -> Encoded:
    """Write a scene; the suffix chooses the format, and the file appears whole or not at all.

    Args:
        path: where to write.
        gaussians: the scene.
        metadata: text that goes along, where the format has a place for it.
        suffix: the format, where the path does not say it.

    Returns:
        What was written: its bytes, the number of Gaussians, and notes on repairs.

    Raises:
        OutputError: the file cannot be written.
        UsageError: no format has the file's suffix.
    """
    encoded = encode_scene(gaussians, metadata, suffix or scene_suffix(path))
    with atomic_write(path) as temporary:
        temporary.write_bytes(encoded.data)
    return encoded


def _module(suffix: str) -> ModuleType:
    return import_module(MODULES[suffix])
