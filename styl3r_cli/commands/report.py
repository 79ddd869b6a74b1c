"""The JSON report of a run: one object on standard output, for scripts."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

import click

from styl3r_cli import __version__
from styl3r_cli.cameras.framing import uncropped
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.commands.request import Inputs, SceneRequest
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.pipeline import Repairs

if TYPE_CHECKING:  # it brings numba
    from styl3r_cli.compaction import Compaction


def scene_report(
    request: SceneRequest,
    inputs: Inputs,
    gaussians: Gaussians,
    repairs: Repairs,
    recovered: Recovered,
    notes: list[str],
    timings: dict[str, float],
) -> dict[str, Any]:
    """What went in, what came out, how it went and how long it took, as plain values.

    Cameras are in pixels of the photos as shown; extrinsics are world-to-camera with OpenCV axes.
    Timings are in seconds by stage.
    """
    model, photos = inputs.stylizer.model, inputs.photos
    height, width = photos.images.shape[2:]
    outputs = {
        "scene": request.scene_path,
        "video": request.video,
        "preview": request.preview,
        "cameras": request.cameras_out,
    }
    return {
        "command": request.command,
        "version": __version__,
        "model": {"name": model.name, "folder": str(model.folder), "device": model.device},
        "size": [width, height],
        "views": _views(inputs, recovered),
        "styles": [{"path": str(style.path), "weight": style.weight} for style in request.styles],
        "strength": request.strength,
        "gaussians": len(gaussians),
        "outputs": {name: str(path) for name, path in outputs.items() if path is not None},
        "repairs": repairs.to_dict(),
        "warnings": list(notes),
        "timings": rounded(timings),
    }


def compaction_report(made: Compaction) -> dict[str, Any]:
    """What was kept of a scene's Gaussians, and what was measured, as plain values."""
    measured = [value for value in made.decibels if math.isfinite(value)]
    before, after = len(made.labels), len(made.gaussians)
    return {
        "gaussians": {"before": before, "after": after},
        "kept": after / before,
        "cameras": len(made.cameras),
        "worst_db": min(measured) if measured else None,
        "mean_db": sum(measured) / len(measured) if measured else None,
    }


def kept_line(made: Compaction) -> str:
    """The same, for people."""
    before, after = len(made.labels), len(made.gaussians)
    line = f"{after:,} of {before:,} Gaussians kept ({100 * after / before:.1f} %)"
    if not made.decibels:  # of a format without Gaussians
        return line
    if not math.isfinite(made.worst):
        return f"{line}: fewer would show"
    return f"{line}; {made.worst:.1f} dB at the worst of {len(made.cameras)} cameras"


def rounded(timings: dict[str, float]) -> dict[str, float]:
    """Seconds by stage, to a tenth of a millisecond."""
    return {name: round(seconds, 4) for name, seconds in timings.items()}


def print_report(report: dict[str, Any]) -> None:
    """One JSON object, then a line end."""
    # A name's bytes that are no text are escaped as Python has them, so that it can be found again.
    click.echo(json.dumps(report, indent=2, allow_nan=False))


def _views(inputs: Inputs, recovered: Recovered) -> list[dict[str, Any]]:
    photos = inputs.photos
    views = []
    for index, (path, (width, height)) in enumerate(zip(photos.paths, photos.sizes, strict=True)):
        camera = uncropped(recovered.cameras[index], width, height)
        views.append(
            {
                "path": str(path),
                "width": width,
                "height": height,
                "focal_source": photos.focal_sources[index],
                "camera": {
                    "recovered": recovered.recovered[index],
                    "inlier_ratio": round(recovered.inlier_ratios[index], 4),
                    "fx": camera.fx,
                    "fy": camera.fy,
                    "cx": camera.cx,
                    "cy": camera.cy,
                    "extrinsics": camera.extrinsics.tolist(),
                },
            }
        )
    return views
