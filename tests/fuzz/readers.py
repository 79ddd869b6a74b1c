"""Every reader of foreign bytes as a function to fuzz: it may refuse them, in one way only."""

from __future__ import annotations

import atexit
import shutil
import struct
import tempfile
import warnings
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from bundle import Bundle
from PIL import Image

from styl3r_cli import manifest as manifests
from styl3r_cli.cameras.camera_path import read_camera_path
from styl3r_cli.cameras.stored import cameras_from_metadata
from styl3r_cli.cameras.transforms import read_transforms
from styl3r_cli.errors import InputError, ModelError
from styl3r_cli.formats import read_scene
from styl3r_cli.formats.values import ATTRIBUTES
from styl3r_cli.photos import decode as decoding
from styl3r_cli.photos.depth import read_depth
from styl3r_cli.photos.focal import LONGEST_FOCAL, SHORTEST_FOCAL, read_equivalent_focal
from styl3r_cli.photos.listing import parse_list

LONGEST_MESSAGE = 600  # of an error; a damaged file's contents do not belong in it
CORPUS = Path(__file__).parent / "corpus"
# Files that are written a million times belong in memory: a disk's takes up to 20 times as long.
MEMORY = "/dev/shm"
SCRATCH = Path(
    tempfile.mkdtemp(prefix="styl3r-fuzz-", dir=MEMORY if Path(MEMORY).is_dir() else None)
)
atexit.register(shutil.rmtree, SCRATCH, ignore_errors=True)


@dataclass(frozen=True)
class Reader:
    """A function of any bytes, and the one kind of error that it may raise."""

    read: Callable[[bytes], None]
    refusal: type[Exception] = InputError
    corpus: str = ""  # the folder of seeds, where it is another reader's

    def attempt(self, data: bytes) -> bool:
        """Whether the bytes were read; False if they were refused as they should be.

        Raises:
            Exception: of any other kind, or an unreadable refusal: a finding.
        """
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self.read(data)
        except self.refusal as error:
            message = str(error)
            if len(message) > LONGEST_MESSAGE or "\n" in message:
                raise AssertionError(f"no short line: {message[:LONGEST_MESSAGE]}") from error
            return False
        return True


def scene(suffix: str) -> Reader:
    """A reader of scenes: whatever it returns is finite."""

    def read(data: bytes) -> None:
        found = read_scene(data, suffix)
        for name in ATTRIBUTES:
            assert np.isfinite(getattr(found.gaussians, name)).all(), f"{name} are not finite"
        opacities = found.gaussians.opacities
        assert ((opacities >= 0) & (opacities <= 1)).all(), "opacities beyond 0 to 1"
        assert (found.gaussians.scales >= 0).all(), "negative scales"
        cameras_from_metadata(found.metadata)

    return Reader(read, corpus=suffix[1:])


SPZ, SOG, GLB = scene(".spz"), scene(".sog"), scene(".glb")


def spz_body(data: bytes) -> None:
    """What gzip's checksum would hide from a fuzzer."""
    packer = zlib.compressobj(1, zlib.DEFLATED, 16 + zlib.MAX_WBITS)
    SPZ.read(packer.compress(data) + packer.flush())


@cache
def good(name: str) -> bytes:
    """The first seed of a reader."""
    return min((CORPUS / name).iterdir()).read_bytes()


@cache
def sog_bundle(member: str) -> Bundle:
    """A good scene, of which one member can be replaced."""
    return Bundle(good("sog"), member)


def sog_meta(data: bytes) -> None:
    """meta.json in a bundle whose pictures and checksums are right."""
    SOG.read(sog_bundle("meta.json").having(data))


def sog_picture(data: bytes) -> None:
    """Colours and opacities as a picture of any kind and size, behind a checksum that is right."""
    SOG.read(sog_bundle("sh0.webp").having(data))


def glb_json(data: bytes) -> None:
    """A description with lengths that are right, beside the binary part of a good file."""
    whole = good("glb")
    length = struct.unpack_from("<I", whole, 12)[0]
    text = data + b" " * (-len(data) % 4)
    rest = whole[20 + length :]
    size = 20 + len(text) + len(rest)
    head = struct.pack("<IIIII", 0x46546C67, 2, size, len(text), 0x4E4F534A)
    GLB.read(head + text + rest)


def in_file(name: str, read: Callable[[Path], object]) -> Callable[[bytes], None]:
    """For readers that take a path."""

    def attempt(data: bytes) -> None:
        path = SCRATCH / name
        path.write_bytes(data)
        read(path)

    return attempt


def exif(data: bytes) -> None:
    """The focal length of a photo with these EXIF bytes: a plausible one, or none."""
    image = Image.new("RGB", (64, 48))
    image.info["exif"] = b"Exif\0\0" + data
    focal = read_equivalent_focal(image)
    assert focal is None or SHORTEST_FOCAL <= focal <= LONGEST_FOCAL
    image.getexif().get(decoding.ORIENTATION, 1)


def graph(path: Path) -> None:
    """A graph whose checksum is right, as far as a session and its signature."""
    from styl3r_cli.graphs import STRUCTURE_INPUTS, STRUCTURE_OUTPUTS
    from styl3r_cli.sessions import Graph

    Graph.load(path, "cpu", 1).check(STRUCTURE_INPUTS, {}, STRUCTURE_OUTPUTS)


def checkpoint(path: Path) -> None:
    """A whole torch file."""
    from styl3r_export.safe_pickle import read_checkpoint

    read_checkpoint(path)


@cache
def checkpoint_bundle() -> Bundle:
    """A good checkpoint."""
    return Bundle(good("checkpoint"), "/data.pkl")


def pickled(data: bytes) -> None:
    """The pickle inside of a torch file, with its checksum right."""
    path = SCRATCH / "pickle.pt"
    path.write_bytes(checkpoint_bundle().having(data))
    checkpoint(path)


READERS = {
    "photo": Reader(in_file("photo", decoding.decode)),
    "depth": Reader(in_file("depth.png", read_depth)),
    "depth-array": Reader(in_file("depth.npy", read_depth)),
    "exif": Reader(exif),
    "ply": scene(".ply"),
    "compressed-ply": Reader(scene(".compressed.ply").read, corpus="compressed.ply"),
    "splat": scene(".splat"),
    "spz": SPZ,
    "spz-body": Reader(spz_body),
    "sog": SOG,
    "sog-meta": Reader(sog_meta),
    "sog-picture": Reader(sog_picture),
    "glb": GLB,
    "glb-json": Reader(glb_json),
    "transforms": Reader(lambda data: void(read_transforms(data))),
    "camera-path": Reader(lambda data: void(read_camera_path(data))),
    "list": Reader(lambda data: void(parse_list(data, data[:1] == b"\0"))),
    "manifest": Reader(
        in_file(manifests.MANIFEST, lambda path: manifests.read_manifest(path.parent)), ModelError
    ),
    "onnx": Reader(in_file("graph.onnx", graph), ModelError),
    "checkpoint": Reader(in_file("checkpoint.pt", checkpoint)),
    "pickle": Reader(pickled),
}


def void(_: object) -> None:
    """Leave a result alone."""


def seeds(name: str) -> Path:
    """The folder of a reader's committed files."""
    return CORPUS / (READERS[name].corpus or name)
