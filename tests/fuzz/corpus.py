"""Writes the seeds: a few small good files for every reader, made by the project itself."""

from __future__ import annotations

import gzip
import io
import struct
import sys
import zipfile
from pathlib import Path

import numpy as np
import torch
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1]))
from tiny_model import STRUCTURE_GRAPH, parse_graph, write_model

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.camera_path import write_camera_path
from styl3r_cli.cameras.stored import cameras_to_metadata
from styl3r_cli.formats import MODULES, encode_scene
from styl3r_cli.gaussians import Gaussians

CORPUS = Path(__file__).parent / "corpus"
CAMERA = Camera(np.eye(4), 60, 60, 32, 24, 64, 48)


def small_scene() -> Gaussians:
    """Eight Gaussians."""
    r = np.random.default_rng(0)
    turns = r.normal(size=(8, 4))
    return Gaussians(
        r.normal(size=(8, 3)),
        r.uniform(0.01, 1, (8, 3)),
        turns / np.linalg.norm(turns, axis=1, keepdims=True),
        r.uniform(size=8),
        r.uniform(size=(8, 3)),
    )


def put(name: str, file: str, data: bytes) -> None:
    """One seed."""
    folder = CORPUS / name
    folder.mkdir(parents=True, exist_ok=True)
    (folder / file).write_bytes(data)


def scenes() -> None:
    """One of each format, and what is inside of those with checksums."""
    metadata = {"generator": "styl3r", **cameras_to_metadata([CAMERA])}
    for suffix in MODULES:
        if suffix != ".points.glb":
            data = encode_scene(small_scene(), metadata, suffix).data
            put(suffix[1:], f"scene{suffix}", data)
    ascii_ply = "ply\nformat ascii 1.0\nelement vertex 1\n" + "".join(
        f"property float {name}\n"
        for name in [
            "x",
            "y",
            "z",
            "f_dc_0",
            "f_dc_1",
            "f_dc_2",
            "opacity",
            "scale_0",
            "scale_1",
            "scale_2",
            "rot_0",
            "rot_1",
            "rot_2",
            "rot_3",
        ]
    )
    put("ply", "ascii.ply", (ascii_ply + "end_header\n" + "1 " * 14 + "\n").encode())
    put("spz-body", "body", gzip.decompress((CORPUS / "spz/scene.spz").read_bytes()))
    bundle = zipfile.ZipFile(CORPUS / "sog/scene.sog")
    put("sog-meta", "meta.json", bundle.read("meta.json"))
    put("sog-picture", "sh0.webp", bundle.read("sh0.webp"))
    glb = (CORPUS / "glb/scene.glb").read_bytes()
    put("glb-json", "scene.json", glb[20 : 20 + struct.unpack_from("<I", glb, 12)[0]])


def pictures() -> None:
    """A dozen pixels in every format, with EXIF where there is a place for it."""
    rgb = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    image = Image.fromarray(rgb)
    exif = Image.Exif()
    exif[0x0112] = 6
    exif.get_ifd(0x8769).update({0xA405: 28, 0x920A: 4.2, 0xA20E: 3000.0, 0xA210: 3, 0xA002: 8})
    for kind in ("jpeg", "png", "webp", "tiff", "bmp", "gif", "ppm", "avif"):
        buffer = io.BytesIO()
        image.save(buffer, kind, **({"exif": exif} if kind in ("jpeg", "png", "tiff") else {}))
        put("photo", f"small.{kind}", buffer.getvalue())
    deep = Image.fromarray(rgb[..., 0].astype(np.uint16) * 257)
    for mode in ("P", "LA", "RGBA", "CMYK"):
        buffer = io.BytesIO()
        image.convert(mode).save(buffer, "tiff")
        put("photo", f"{mode}.tiff", buffer.getvalue())
    buffer = io.BytesIO()
    deep.save(buffer, "tiff")
    put("photo", "deep.tiff", buffer.getvalue())
    put("exif", "focal", exif.tobytes().removeprefix(b"Exif\0\0"))


def depths() -> None:
    """Depth pictures of 16 and 32 bits, and an array."""
    millimetres = np.arange(12, dtype=np.uint16).reshape(3, 4) * 1000
    for name, values in (("deep.png", millimetres), ("metres.tiff", millimetres / np.float32(1e3))):
        buffer = io.BytesIO()
        Image.fromarray(values).save(buffer, Path(name).suffix[1:])
        put("depth", name, buffer.getvalue())
    buffer = io.BytesIO()
    np.save(buffer, millimetres)
    put("depth-array", "depth.npy", buffer.getvalue())


def others() -> None:
    """Cameras, lists, a model and a checkpoint."""
    put("camera-path", "path.json", b"")
    write_camera_path(CORPUS / "camera-path/path.json", [CAMERA], 24, True)
    put("transforms", "path.json", (CORPUS / "camera-path/path.json").read_bytes())
    put("list", "lines", b"a.jpg\r\nb c.jpg\n\xff.png\n")
    put("list", "nul", b"\0a\0b\n\0")
    put("onnx", "structure.onnx", parse_graph(STRUCTURE_GRAPH).SerializeToString())
    folder = CORPUS / "model"
    write_model(folder)
    put("manifest", "manifest.json", (folder / "manifest.json").read_bytes())
    for file in folder.iterdir():
        file.unlink()
    folder.rmdir()
    buffer = io.BytesIO()
    torch.save({"w": torch.arange(4.0), "n": [1, "a", None]}, buffer)
    put("checkpoint", "small.pt", buffer.getvalue())
    whole = zipfile.ZipFile(buffer)
    (inner,) = (name for name in whole.namelist() if name.endswith("/data.pkl"))
    put("pickle", "data.pkl", whole.read(inner))


if __name__ == "__main__":
    scenes()
    pictures()
    depths()
    others()
