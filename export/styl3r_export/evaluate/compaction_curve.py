"""PSNR against the share of Gaussians kept: `styl3r compact` beside other ways to have fewer.

    python -m styl3r_export.evaluate.compaction_curve scene.ply other.ply --shares 0.25 0.08

Each scene (with its cameras, as `styl3r stylize --all` writes it) is reduced to the same numbers of
Gaussians by every method, and drawn from its views, halfway between them (which compaction
answers to), and a quarter before and after (which it never saw). Prints one CSV line each, and a
table of the medians over all scenes on standard error.
"""

from __future__ import annotations

import argparse
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.stored import cameras_from_metadata
from styl3r_cli.compaction import in_between, keep_count, witnesses
from styl3r_cli.errors import InputError, Styl3rError, UsageError
from styl3r_cli.formats import read_scene, write_scene
from styl3r_cli.gaussians import FloatArray, Gaussians
from styl3r_cli.splatting import render

SHARES = (1.0, 0.5, 0.35, 0.25, 0.15, 0.08, 0.04, 0.02)
NO_ERROR = 1e-12
FINEST = 1e-6  # of the scene: 21 bits a side
GRID_ATTEMPTS = 24
SEED = 0

Method = Callable[[Gaussians, list[Camera], int], Gaussians]


def compacted(scene: Gaussians, cameras: list[Camera], count: int) -> Gaussians:
    """What `styl3r compact --max-gaussians` keeps."""
    return keep_count(scene, cameras, count).gaussians


def random_choice(scene: Gaussians, _cameras: list[Camera], count: int) -> Gaussians:
    """Any of them."""
    chosen = np.random.default_rng(SEED).choice(len(scene), count, replace=False)
    return scene.select(np.sort(chosen))


def most_opaque(scene: Gaussians, _cameras: list[Camera], count: int) -> Gaussians:
    """Those of the highest opacity; at random where that is the same, as `mini` gives it."""
    ties = np.random.default_rng(SEED).random(len(scene))
    order = np.lexsort((ties, -scene.opacities))
    return scene.select(np.sort(order[:count]))


def voxel_grid(scene: Gaussians, _cameras: list[Camera], count: int) -> Gaussians:
    """One Gaussian a voxel: plain means, and moments along the axes; as many as fit `count`."""
    extent = np.ptp(scene.means, axis=0).max()
    low, high = FINEST * extent, extent
    for _ in range(GRID_ATTEMPTS):
        side = math.sqrt(low * high)
        found = len(np.unique(_cells(scene.means, side)))
        low, high = (side, high) if found > count else (low, side)
    cells, labels = np.unique(_cells(scene.means, high), return_inverse=True)
    sizes = np.bincount(labels, minlength=len(cells))[:, None]

    def mean(values: np.ndarray) -> np.ndarray:
        columns = [np.bincount(labels, column, len(cells)) for column in values.T]
        return np.stack(columns, -1) / sizes

    means = mean(scene.means)
    spread = mean((scene.means - means[labels]) ** 2)
    scales = np.sqrt(mean((scene.scales**2).mean(axis=1, keepdims=True)) + spread)
    upright = np.tile([1.0, 0, 0, 0], (len(cells), 1))
    opacities = mean(scene.opacities[:, None])[:, 0]
    return Gaussians(means, scales, upright, opacities, mean(scene.colours))


def _cells(means: np.ndarray, side: float) -> np.ndarray:
    """(G,) one number for each voxel."""
    places = np.floor((means - means.min(axis=0)) / side).astype(np.int64)
    return (places[:, 0] << 42) + (places[:, 1] << 21) + places[:, 2]


def splat_transform(program: str) -> Method:
    """PlayCanvas's decimation (pairwise merging, after NanoGS, arXiv 2603.16103)."""

    def decimate(scene: Gaussians, _cameras: list[Camera], count: int) -> Gaussians:
        with tempfile.TemporaryDirectory() as folder:
            source, target = Path(folder, "in.ply"), Path(folder, "out.ply")
            write_scene(source, scene)
            command = [program, "-q", "--gpu", "cpu", str(source), "--decimate", str(count)]
            try:
                subprocess.run([*command, str(target)], check=True, capture_output=True)
            except (OSError, subprocess.CalledProcessError) as error:
                raise UsageError(f"--splat-transform: {error}") from error
            return read_scene(target).gaussians

    return decimate


OURS = "compact"
METHODS: dict[str, Method] = {
    OURS: compacted,
    "random": random_choice,
    "opacity": most_opaque,
    "voxels": voxel_grid,
}
HEADER = "scene,method,share,kept,db_witnesses,db_worst,db_unseen,seconds,cpu_seconds"


def frames(scene: Gaussians, cameras: Sequence[Camera]) -> list[FloatArray]:
    """Each camera's (2, H, W, 3) frames on black and on white, clipped as files are."""
    found = []
    for camera in cameras:
        drawn = render(scene, camera)
        through = 1 - drawn.alpha[..., None]
        found.append(np.clip([drawn.colour, drawn.colour + through], 0, 1))
    return found


def decibels(whole: Sequence[FloatArray], kept: Sequence[FloatArray]) -> list[float]:
    """PSNR of each camera's frames, over both backgrounds."""
    squares = [float(np.mean((a - b) ** 2)) for a, b in zip(whole, kept, strict=True)]
    return [-10 * math.log10(max(square, NO_ERROR)) for square in squares]


@dataclass(frozen=True)
class Row:
    """What came of a scene, a method and a share.

    Attributes:
        scene: the file's name.
        method: of METHODS.
        share: of the Gaussians that were asked for.
        kept: how many there are.
        witnesses: mean PSNR at the cameras that compaction answers to.
        worst: PSNR at the worst of them.
        unseen: mean PSNR at cameras that it never saw.
        seconds: on the clock.
        cpu_seconds: of this process's threads.
    """

    scene: str
    method: str
    share: float
    kept: int
    witnesses: float
    worst: float
    unseen: float
    seconds: float
    cpu_seconds: float

    def csv(self) -> str:
        """One line, in the order of HEADER."""
        values = (self.witnesses, self.worst, self.unseen, self.seconds, self.cpu_seconds)
        numbers = ",".join(f"{value:.2f}" for value in values)
        return f"{self.scene},{self.method},{self.share:g},{self.kept},{numbers}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the curve of every scene and method as CSV, and the medians."""
    parser = argparse.ArgumentParser(description="PSNR against the share of Gaussians kept")
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--shares", nargs="+", type=_share, default=SHARES)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--splat-transform", metavar="PROGRAM", help="also its --decimate")
    options = parser.parse_args(arguments)
    methods = {name: METHODS[name] for name in options.methods}
    if options.splat_transform:
        methods["splat-transform"] = splat_transform(options.splat_transform)
    print(HEADER)
    rows = []
    try:
        for path in options.scenes:
            for row in _curve(path, methods, options.shares):
                print(row.csv(), flush=True)
                rows.append(row)
    except Styl3rError as error:
        print(f"Error: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    print(medians(rows), file=sys.stderr)


def _share(text: str) -> float:
    share = float(text)
    if not 0 < share <= 1:
        raise argparse.ArgumentTypeError(f"{text} is no share: above 0, 1 at most")
    return share


def medians(rows: Sequence[Row]) -> str:
    """A table of the median scene's PSNR at the witnesses, a method a column.

    Behind a baseline's figure: in how many scenes compaction is better, of how many.
    """
    names = list(dict.fromkeys(row.method for row in rows))
    found = {(row.scene, row.method, row.share): row.witnesses for row in rows}
    scenes = list(dict.fromkeys(row.scene for row in rows))
    lines = ["| share | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    for share in dict.fromkeys(row.share for row in rows):
        cells = []
        for name in names:
            cell = f"{np.median([found[scene, name, share] for scene in scenes]):.1f} dB"
            if name != OURS and OURS in names:
                ahead = [found[scene, OURS, share] > found[scene, name, share] for scene in scenes]
                cell += f" ({sum(ahead)}/{len(ahead)})"
            cells.append(cell)
        lines.append(f"| {100 * share:g} % | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _curve(path: Path, methods: dict[str, Method], shares: Sequence[float]) -> Iterator[Row]:
    stored = read_scene(path)
    scene, views = stored.gaussians, cameras_from_metadata(stored.metadata)
    if len(views) < 2:
        raise InputError(f"{path}: it has {len(views)} cameras; the curve needs at least two")
    cameras, unseen = witnesses(views, scene), in_between(views, (0.25, 0.75))
    whole = frames(scene, [*cameras, *unseen])
    for share in shares:
        for name, reduce in methods.items():
            start, worked = time.perf_counter(), time.process_time()
            kept = reduce(scene, cameras, max(1, round(share * len(scene))))
            worked, took = time.process_time() - worked, time.perf_counter() - start
            found = decibels(whole, frames(kept, [*cameras, *unseen]))
            seen, other = found[: len(cameras)], found[len(cameras) :]
            yield Row(
                path.stem, name, share, len(kept),
                float(np.mean(seen)), min(seen), float(np.mean(other)), took, worked,
            )  # fmt: skip


if __name__ == "__main__":
    main()
