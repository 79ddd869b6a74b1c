"""What each stored precision loses on ordinary and on hostile views: pictures, in decibels.

`pytest -m slow -s tests/numerics/test_precisions_at_extremes.py` prints the table of
docs/numerics.md.
"""

from __future__ import annotations

import numpy as np
import pytest
from hostile_pictures import HOSTILE, ORDINARY, photos_of, wall

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.graphs import find
from styl3r_cli.picture_metrics import psnr
from styl3r_cli.pipeline import Stylizer, assemble
from styl3r_cli.splatting import render
from styl3r_cli.tradeoff.agreement import BROKEN_DB

pytest.importorskip("onnx", reason="onnx makes the other precisions")

# Views like those that int8-static's and mixed's ranges are calibrated on.
ORDINARY_ONES = (ORDINARY, "identical views", "one dot", "principal point outside")
PRECISIONS = ("fp16", "w8", "w4", "int8", "int8-static", "mixed")
SAMPLES = {ORDINARY: lambda: photos_of(wall())} | HOSTILE


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, list[np.ndarray]]]:
    """For each precision and sample, the pictures of its scene from the first view's camera."""
    from styl3r_export.quantise.calibration import Sample
    from styl3r_export.quantise.folders import convert_folder

    folder = tmp_path_factory.mktemp("precisions")
    calibration = [Sample(ORDINARY, photos_of(wall()), [])]
    pictures = {}
    for precision in ("fp32", *PRECISIONS):
        target = folder / precision
        convert_folder(find("mini"), target, precision, calibration, verify=False)
        stylizer = Stylizer(str(target), "cpu", threads=1)
        pictures[precision] = {name: _look(stylizer, name) for name in SAMPLES}
    return pictures


def _look(stylizer: Stylizer, name: str) -> list[np.ndarray]:
    """From the first camera, and from beside it: a twentieth of the median depth to the right."""
    photos = SAMPLES[name]()
    height, width = photos.images.shape[2:]
    scene = stylizer.encode(photos)
    gaussians, repairs = assemble(scene, stylizer.colours(scene, strength=0))
    assert repairs.dropped_not_finite == 0, name
    k = photos.intrinsics[0] * np.float32([[width], [height], [1]])
    looks = []
    for step in (0.0, 0.05):
        pose = np.eye(4)
        pose[0, 3] = -step * float(np.median(gaussians.means[:, 2]))
        camera = Camera(
            pose, *(float(k[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2))), width, height
        )
        looks.append(render(gaussians, camera, threads=1).colour)
    return looks


def decibels(pictures: list[np.ndarray], reference: list[np.ndarray]) -> float:
    """Of the worse of the two pictures."""
    return min(psnr(a, b) for a, b in zip(pictures, reference, strict=True))


# What the documentation says not to trust: four bits on noise, of which nothing can be matched.
TOO_COARSE = {("w4", "saturated noise")}


@pytest.mark.slow
def test_every_precision_is_sound_and_trustworthy_where_it_is_said(
    made: dict[str, dict[str, list[np.ndarray]]],
) -> None:
    table = {
        precision: {n: decibels(made[precision][n], made["fp32"][n]) for n in SAMPLES}
        for precision in PRECISIONS
    }
    print("\n" + f"{'views':26}" + "".join(f"{p:>13}" for p in PRECISIONS))
    for name in SAMPLES:
        print(f"{name:26}" + "".join(f"{table[p][name]:10.1f} dB" for p in PRECISIONS))
    for looks in made.values():
        assert all(np.isfinite(picture).all() for both in looks.values() for picture in both)
    assert min(table["fp16"][name] for name in SAMPLES) == 100.0  # the bundled weights are fp16
    for precision in ("w8", "w4", "int8", "mixed"):
        for name, found in table[precision].items():
            assert found >= BROKEN_DB or (precision, name) in TOO_COARSE, (precision, name)
    # Calibrated ranges hold for what they were calibrated on.
    assert min(table["int8-static"][name] for name in ORDINARY_ONES) >= BROKEN_DB
