"""The same scene in Mitsuba 3, which traces rays through Gaussians: another CPU path to time."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import FloatArray, Gaussians

NAME = "Mitsuba 3"
VARIANT = "llvm_ad_rgb"  # the only one on a CPU that its integrator for Gaussians is made for
SH_0 = 0.28209479177387814  # the constant spherical harmonic, which colours are divided by there
NEAR, FAR = 1e-3, 1e4  # scene units; it wants bounds
GAUSSIANS = ("means", "scales", "rotations", "opacities", "colours")


class NoFrame(Exception):
    """Mitsuba drew nothing; the message says why."""


def is_installed() -> bool:
    """Whether Mitsuba is there; whether the LLVM that it needs is, only drawing tells."""
    return find_spec("mitsuba") is not None


def frame_seconds(
    scene: Gaussians, camera: Camera, threads: int, repeats: int, limit: float
) -> list[tuple[float, float]]:
    """Seconds by the clock and of the cores that frames take, without reading the scene.

    In a process of its own, because an LLVM that does not suit it ends the process.

    Args:
        scene: what to draw.
        camera: where from.
        threads: on how many cores.
        repeats: how many frames, at most.
        limit: seconds after which no further frame begins; a first one is always drawn.

    Raises:
        NoFrame: it could not draw.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.npz"
        arrays = {name: getattr(scene, name) for name in GAUSSIANS}
        size = (camera.width, camera.height)
        np.savez(path, **arrays, view=camera.extrinsics, focal=camera.fx, size=size)
        child = [sys.executable, "-m", __name__, str(path), str(threads), str(repeats), str(limit)]
        result = subprocess.run(child, capture_output=True, text=True, check=False)
    if result.returncode:
        said = result.stderr.strip().splitlines() or [f"it ended with code {result.returncode}"]
        raise NoFrame(next((line for line in said if "LLVM ERROR" in line), said[-1]))
    return [(clock, cores) for clock, cores in json.loads(result.stdout)]


def to_mitsuba(scene: Gaussians, view: FloatArray, focal: float, width: int, height: int) -> Any:
    """The scene and a camera with the principal point in the middle, as Mitsuba has them.

    Args:
        scene: what to draw.
        view: (4, 4) world to camera, in OpenCV's axes; Mitsuba's x and y point the other way.
        focal: in pixels.
        width: of the frame, in pixels.
        height: of the frame, in pixels.
    """
    import mitsuba

    def tensor(values: FloatArray) -> Any:
        return mitsuba.TensorXf(np.ascontiguousarray(values, np.float32))

    pose = np.linalg.inv(view) @ np.diag([-1.0, -1.0, 1.0, 1.0])
    unit = scene.rotations / np.linalg.norm(scene.rotations, axis=1, keepdims=True)
    return mitsuba.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "volprim_rf_basic", "srgb_primitives": False, "max_depth": -1},
            "sensor": {
                "type": "perspective",
                "fov": float(np.degrees(2 * np.arctan(width / 2 / focal))),
                "fov_axis": "x",
                "near_clip": NEAR,
                "far_clip": FAR,
                "to_world": mitsuba.ScalarTransform4f(pose),
                "film": {
                    "type": "hdrfilm",
                    "width": width,
                    "height": height,
                    "rfilter": {"type": "box"},
                    "pixel_format": "rgb",
                },
            },
            "shape": {
                "type": "ellipsoids",
                "centers": tensor(scene.means),
                "scales": tensor(scene.scales),
                "quaternions": tensor(unit[:, [1, 2, 3, 0]]),  # x y z w
                "opacities": tensor(scene.opacities[:, None]),
                "sh_coeffs": tensor((scene.colours - 0.5) / SH_0),
            },
        }
    )


def draw(scene: Any, rays: int = 1) -> FloatArray:
    """A frame (height, width, 3) of what `to_mitsuba` made, with so many rays a pixel."""
    import mitsuba

    return np.array(mitsuba.render(scene, spp=rays, seed=0))


def _child(path: str, threads: int, repeats: int, limit: float) -> list[tuple[float, float]]:
    import drjit
    import mitsuba

    mitsuba.set_variant(VARIANT)
    drjit.set_thread_count(threads)
    with np.load(path) as file:
        gaussians = Gaussians(*(file[name] for name in GAUSSIANS))
        scene = to_mitsuba(gaussians, file["view"], float(file["focal"]), *file["size"].tolist())
    draw(scene)  # compiles
    taken: list[tuple[float, float]] = []
    while len(taken) < repeats and (not taken or sum(clock for clock, _ in taken) < limit):
        start, worked = time.perf_counter(), time.process_time()
        draw(scene)
        taken.append((time.perf_counter() - start, time.process_time() - worked))
    return taken


if __name__ == "__main__":
    print(json.dumps(_child(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]))))
