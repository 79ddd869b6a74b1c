"""The facts that `styl3r info` tells, as plain values and as a table."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from styl3r_cli import limits, needs
from styl3r_cli.cameras.stored import KEY, cameras_from_metadata
from styl3r_cli.commands.scene_file import SceneFile
from styl3r_cli.console import one_line
from styl3r_cli.errors import OutputError
from styl3r_cli.formats import MODULES, Scene, encode_scene
from styl3r_cli.formats.values import ATTRIBUTES
from styl3r_cli.gaussians import Gaussians

MIDDLE = 0.5  # the quantile beside a range's ends
DIGITS = 6  # of numbers in the table
AXES, CHANNELS = ("x", "y", "z"), ("red", "green", "blue")


def facts(name: str, file: SceneFile) -> dict[str, Any]:
    """What is in a file, as values for JSON.

    Lengths are in scene units; `bounds` are those of the means, `ranges` have least, middle
    (median) and most. Ranges of an empty scene are null.
    """
    scene = file.scene
    cameras = cameras_from_metadata(scene.metadata)
    stored = {KEY.format(index) for index in range(len(cameras))}
    return {
        "path": name,
        "format": file.suffix,
        "bytes": file.size,
        "gaussians": len(scene.gaussians),
        "non_finite": {"gaussians": scene.dropped}
        | {key: scene.non_finite.get(key, 0) for key in ATTRIBUTES},
        "bounds": _bounds(scene.gaussians),
        "ranges": _ranges(scene.gaussians),
        "cameras": [
            {
                "width": camera.width,
                "height": camera.height,
                "fx": camera.fx,
                "fy": camera.fy,
                "cx": camera.cx,
                "cy": camera.cy,
                "extrinsics": camera.extrinsics.tolist(),
            }
            for camera in cameras
        ],
        "metadata": {key: text for key, text in scene.metadata.items() if key not in stored},
        "notes": scene.notes,
    }


def sizes_by_format(scene: Scene, done: Callable[[], None]) -> dict[str, int]:
    """Bytes of the scene in every format that can hold it; `done` is called after each.

    Raises:
        OutOfMemoryError: this process may not use what the dearest of them takes.
    """
    limits.check(needs.points())
    sizes = {}
    for suffix in MODULES:
        with suppress(OutputError):
            sizes[suffix] = len(encode_scene(scene.gaussians, scene.metadata, suffix).data)
        done()
    return sizes


def table(report: dict[str, Any]) -> str:
    """The same for people."""
    count = report["gaussians"]
    size = f"{report['format']}, {_megabytes(report['bytes'])}, {count:,} Gaussians"
    lines = [f"{one_line(report['path'])}: {size}"]
    if count:
        lines += ["", f"{'':10}{'least':>14}{'middle':>14}{'most':>14}"]
        for name, ends in report["ranges"].items():
            numbers = (f"{ends[key]:>14.{DIGITS}g}" for key in ("least", "middle", "most"))
            lines.append(f"{name:10}{''.join(numbers)}")
    bad = {key: value for key, value in report["non_finite"].items() if value}
    told = ", ".join(f"{value} in {key}" for key, value in bad.items() if key != "gaussians")
    dropped = report["non_finite"]["gaussians"]
    lines += ["", f"not finite  {dropped} Gaussians ({told})" if bad else "not finite  none"]
    sizes = sorted({f"{c['width']}x{c['height']}" for c in report["cameras"]})
    cameras = f"{len(report['cameras'])}" + (f" ({', '.join(sizes)})" if sizes else "")
    lines.append(f"cameras     {cameras}")
    # A file may say anything here: sequences that control a terminal, or bytes that are no text.
    lines += [f"{key:11} {one_line(value)}" for key, value in report["metadata"].items()]
    if "sizes" in report:
        lines += ["", "in every format"]
        for suffix, size_in in report["sizes"].items():
            each = f"{size_in / count:>8.1f} bytes a Gaussian" if count else ""
            lines.append(f"{suffix:16}{_megabytes(size_in):>10}{each}")
    return "\n".join(lines)


def _bounds(gaussians: Gaussians) -> dict[str, list[float]] | None:
    if not len(gaussians):
        return None
    means = gaussians.means.astype(np.float64)
    return {"least": means.min(axis=0).tolist(), "most": means.max(axis=0).tolist()}


def _ranges(gaussians: Gaussians) -> dict[str, dict[str, float] | None]:
    columns: dict[str, NDArray[np.float32]] = {
        axis: gaussians.means[:, index] for index, axis in enumerate(AXES)
    }
    columns |= {"scale": gaussians.scales, "opacity": gaussians.opacities}
    columns |= {channel: gaussians.colours[:, i] for i, channel in enumerate(CHANNELS)}
    return {name: _range(values.astype(np.float64)) for name, values in columns.items()}


def _range(values: NDArray[np.float64]) -> dict[str, float] | None:
    if not values.size:
        return None
    middle = float(np.quantile(values, MIDDLE))
    return {"least": float(values.min()), "middle": middle, "most": float(values.max())}


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.2f} MB"
