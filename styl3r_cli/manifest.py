"""What an exported model says about itself: `manifest.json` and the graphs' metadata keys."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

from styl3r_cli.errors import InputError, ModelError, shortened
from styl3r_cli.files import read_file
from styl3r_cli.incoming import Kind

STRUCTURE = "structure.onnx"
APPEARANCE = "appearance.onnx"
MANIFEST = "manifest.json"

# What `format` says in every manifest, and the version of its fields that this code reads.
FORMAT = "styl3r graphs"
FORMAT_VERSION = 1

# Keys of the properties that each graph carries in itself (all values are text).
PROP_MODEL = "styl3r.model"  # "mini", "full"
PROP_MODEL_VERSION = "styl3r.model_version"
PROP_GRAPH = "styl3r.graph"  # "structure" or "appearance"
PROP_WEIGHTS_ID = "styl3r.weights_id"  # the same in both graphs of a model, and in its manifest
PROP_CONFIG = "styl3r.config"  # JSON: the network's configuration
PROP_SOURCE = "styl3r.source_sha256"  # of the checkpoint file, "" when there was none
PROP_LICENCE = "styl3r.licence"
PROP_PRECISION = "styl3r.precision"  # how weights are stored: "fp32", "fp16", "int8", ...
PROP_TOOLS = "styl3r.tools"  # JSON: versions of the programs that wrote the graph
PROP_VERSION = "styl3r.version"  # of this project, when it wrote the graph
PROP_PAINTING_RANGE = "styl3r.painting_range"  # JSON [low, high]: a style picture's values
PROP_PHOTO_RANGE = "styl3r.photo_as_style_range"  # JSON [low, high]: a content photo's, as style
PROP_PICTURES = "styl3r.paints_pictures"  # JSON: whether colours are what the views should show
PROP_INPUT_SIZE = "styl3r.input_size"  # JSON [height, width] that the model was trained at

Field = TypeVar("Field", int, str)
_LARGEST = 1 << 20  # bytes of a manifest: it is half a kilobyte long
_BLOCK = 1 << 22  # bytes hashed at a time


@dataclass(frozen=True)
class FileEntry:
    """Size and checksum of one file of a model."""

    bytes: int
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """The files of one exported model and how they belong together.

    Attributes:
        model: name of the network's configuration.
        model_version: which training of it.
        weights_id: what both graphs carry as `PROP_WEIGHTS_ID`.
        precision: how weights are stored.
        files: by name; every file of the folder but the manifest itself.
    """

    model: str
    model_version: str
    weights_id: str
    precision: str
    files: dict[str, FileEntry]

    def to_json(self) -> str:
        """Readable, with a stable order."""
        head = {"format": FORMAT, "format_version": FORMAT_VERSION}
        return json.dumps(head | asdict(self), indent=2) + "\n"


def describe_files(folder: Path) -> dict[str, FileEntry]:
    """Sizes and checksums of a folder's files, the manifest left out, sorted by name."""
    paths = sorted(p for p in folder.iterdir() if p.is_file() and p.name != MANIFEST)
    return {p.name: FileEntry(p.stat().st_size, sha256_of(p)) for p in paths}


def sha256_of(path: Path) -> str:
    """The file's SHA-256, in hexadecimal."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def read_manifest(folder: Path) -> Manifest:
    """The manifest of an exported model.

    Raises:
        ModelError: it is missing, damaged, or written for another version of this program.
    """
    path = folder / MANIFEST
    try:
        if path.stat().st_size > _LARGEST:
            raise ValueError("too large")
        values = json.loads(read_file(path, Kind("a manifest", _LARGEST)).decode("utf-8"))
    except FileNotFoundError as error:
        message = f"{folder}: no {MANIFEST}; a model is a folder that `styl3r export` wrote"
        raise ModelError(message) from error
    except (OSError, ValueError, RecursionError, InputError) as error:
        raise ModelError(f"{path}: cannot be read ({error}); export the model again") from error
    if not isinstance(values, dict) or values.get("format") != FORMAT:
        raise ModelError(f"{path}: not a manifest of styl3r graphs; export the model again")
    if values.get("format_version") != FORMAT_VERSION:
        found = shortened(str(values.get("format_version")))
        message = f"{path}: format version {found}, this program reads {FORMAT_VERSION}"
        raise ModelError(f"{message}; export the model again")
    return _parse(path, values)


def _parse(path: Path, values: dict[str, Any]) -> Manifest:
    try:
        files = {
            name: FileEntry(_of(int, entry, "bytes"), _of(str, entry, "sha256"))
            for name, entry in values["files"].items()
        }
        model, trained = _of(str, values, "model"), _of(str, values, "model_version")
        identity, precision = _of(str, values, "weights_id"), _of(str, values, "precision")
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        message = f"{path}: a field is missing or of the wrong kind ({error}); export again"
        raise ModelError(message) from error
    missing = {STRUCTURE, APPEARANCE} - files.keys()
    if missing or any(Path(name).name != name for name in files):
        raise ModelError(f"{path}: does not list the two graphs; export the model again")
    return Manifest(model, trained, identity, precision, files)


def _of(kind: type[Field], values: dict[str, Any], key: str) -> Field:
    """A field, of exactly that type.

    Raises:
        KeyError: it is missing.
        TypeError: it is of another.
    """
    value = values[key]
    if type(value) is not kind:  # and no bool for an int
        raise TypeError(f"'{key}' is no {kind.__name__}")
    return value


def check_file(folder: Path, name: str, manifest: Manifest) -> None:
    """Make sure that a file is the one the manifest describes, to the last bit.

    Raises:
        ModelError: it is missing, cut short, or changed.
    """
    entry, path = manifest.files[name], folder / name
    if not path.is_file():
        raise ModelError(f"{path}: missing; export or download the model again")
    size = path.stat().st_size
    if size != entry.bytes:
        message = f"{path}: {size} bytes instead of {entry.bytes}"
        raise ModelError(f"{message}; export or download the model again")
    if sha256_of(path) != entry.sha256:
        raise ModelError(f"{path}: damaged (checksum differs); export or download the model again")


def files_of(graph: str, manifest: Manifest) -> list[str]:
    """A graph's file and the file of its external weights, if it has one."""
    return [name for name in (graph, f"{graph}.data") if name in manifest.files]
