"""What `styl3r tradeoff` does: prepare, measure, and write the report of what there is."""

from __future__ import annotations

import json
import platform
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from styl3r_cli import __version__, limits, needs
from styl3r_cli.commands.checks import check_outputs
from styl3r_cli.console import Console
from styl3r_cli.errors import InputError, OutputError, UsageError
from styl3r_cli.files import atomic_write
from styl3r_cli.frames import Picture, to_picture
from styl3r_cli.limits import available_cores
from styl3r_cli.names import real_path
from styl3r_cli.photos import expand, load_photos
from styl3r_cli.photos.focal import focal_from_fov
from styl3r_cli.photos.load import MAX_VIEWS
from styl3r_cli.pipes import is_pipe
from styl3r_cli.tradeoff.bench import Bench
from styl3r_cli.tradeoff.journal import alone_in
from styl3r_cli.tradeoff.page import make_page
from styl3r_cli.tradeoff.perceptual import Perceptual
from styl3r_cli.tradeoff.points import GIVEN, Dials, Point
from styl3r_cli.tradeoff.prepare import held_out_poses, model_folders, true_cameras, true_depths
from styl3r_cli.tradeoff.rows import Advice, Row, advise, collect, flags
from styl3r_cli.tradeoff.tables import plain, to_csv, to_text
from styl3r_cli.tradeoff.truth import Truth

MOST_VIEWS = 8
PAGE, CSV, JSON = "index.html", "tradeoff.csv", "tradeoff.json"
WORK = "work"  # the folder in the report's that keeps what a resumed run needs


@dataclass(frozen=True)
class Request:
    """The options of `tradeoff`, as the command line gave them."""

    photos: tuple[str, ...]
    styles: tuple[Path, ...]
    output: Path
    holdout: tuple[str, ...]
    lpips: Path | None
    cameras: Path | None
    model: str
    precisions: tuple[str, ...]
    sizes: tuple[int, ...]
    views: tuple[int, ...] | None
    budgets: tuple[float, ...]
    drawings: tuple[str, ...]
    colours: tuple[str, ...]
    threads: tuple[int, ...] | None
    grid: bool
    repeats: int
    fov: float | None
    quiet: bool


def run(request: Request) -> None:
    """Measure all points, and write the report; after Ctrl-C, of what was measured until then.

    Raises:
        Styl3rError: a photo, the model or the report's folder is unusable.
        KeyboardInterrupt: as it came, once the report is written.
    """
    console = Console(request.quiet)
    photos = expand(request.photos, [])
    check(request, photos)
    views = max(request.views or [min(len(photos), MAX_VIEWS)])
    limits.check(needs.scene(views * max(request.sizes) ** 2))
    cameras = true_cameras(request.cameras, photos, console)
    depths = true_depths(request.cameras, photos, request.sizes, console)
    side = request.sizes[0]
    perceptual = None if request.lpips is None else Perceptual(request.lpips, (side, side))
    work = request.output / WORK
    try:
        work.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot make the folder {work}: {error.strerror}") from error
    results = [request.output / name for name in (PAGE, CSV, JSON)]
    check_outputs(results, [*photos, *_files(request)], prints=True)
    with alone_in(work):
        _measure(request, work, photos, Truth([], perceptual, cameras, depths), console)


def _measure(
    request: Request, work: Path, photos: Sequence[Path], truth: Truth, console: Console
) -> None:
    """Make what is missing of models and measurements, and write the report."""
    folders = model_folders(
        request.model, request.precisions, work, photos, request.styles, console
    )
    dials = make_dials(request, len(photos), list(folders))
    points = dials.points(request.grid)
    pictures, poses = _held_out(request, photos, dials.reference, console)
    truth, side = replace(truth, pictures=pictures), dials.reference.size
    bench = Bench(
        *(work, photos, request.styles, request.fov, (side, side), folders, poses, request.cameras),
        depths=bool(truth.depths),
    )
    if bench.resume():
        console.note(f"{request.output}: goes on with what was measured before")
    interrupted = None
    try:
        with console.stage("points", len(bench.left(points, request.repeats))) as done:
            bench.run(points, request.repeats, done)
    except KeyboardInterrupt as error:
        interrupted = error
    rows = collect(bench, points, truth)
    if rows and not rows[0].failed:
        write(request, bench, rows)
    elif rows:
        raise InputError(f"the reference could not be made: {rows[0].failed}")
    if interrupted is not None:
        console.note("interrupted; the same command goes on from here")
        raise interrupted


def check(request: Request, photos: Sequence[Path]) -> None:
    """Refuse what could not be measured.

    Raises:
        UsageError: a size, a number of views or a lens that the network does not take.
        InputError: fewer than two photos, or more than eight.
    """
    if not 2 <= len(photos) <= MOST_VIEWS:
        raise InputError(f"{len(photos)} photos; a trade-off is measured on 2 to {MOST_VIEWS}")
    for size in request.sizes:
        if size % 16:
            raise UsageError(f"--sizes {size}: sides must be multiples of 16")
    if request.views and max(request.views) > len(photos):
        raise UsageError(f"--views {max(request.views)}: there are {len(photos)} photos")
    if request.fov is not None:
        focal_from_fov(request.fov, 1)  # refuses what no lens has
    if request.lpips is not None and not request.holdout:
        raise UsageError("--lpips: there are no pictures to measure it of; name some by --holdout")
    if request.holdout:
        held_out_photos(request, photos)
    for style in request.styles:
        if not style.exists():
            raise InputError(f"{style}: no such style picture")
    for path in _files(request):
        if is_pipe(path):  # each measurement reads it anew
            raise InputError(f"{path}: a pipe; a trade-off reads files")


def _files(request: Request) -> list[Path]:
    """What is read beside the photos."""
    others = (request.cameras, request.lpips)
    return [*request.styles, *(path for path in others if path is not None)]


def make_dials(request: Request, photos: int, precisions: Sequence[str]) -> Dials:
    """The dials, each with the reference's value first."""
    cores = available_cores()
    return Dials(
        precision=[GIVEN, *(name for name in precisions if name != GIVEN)],
        size=request.sizes,
        views=request.views or range(photos, 1, -1),
        budget=request.budgets,
        drawing=request.drawings,
        threads=request.threads or list(dict.fromkeys([cores, 1])),
        colours=request.colours,
    )


def held_out_photos(request: Request, photos: Sequence[Path]) -> list[Path]:
    """The photos to compare with, without those that the network gets.

    Raises:
        UsageError: there are none, or more than fit beside the views.
        InputError: one is not there.
    """
    views = {real_path(path) for path in photos}
    paths = [path for path in expand(request.holdout, []) if real_path(path) not in views]
    if not 1 <= len(paths) <= MOST_VIEWS - len(photos):
        room = f"name 1 to {MOST_VIEWS - len(photos)}" if len(photos) < MOST_VIEWS else "no room"
        raise UsageError(f"--holdout: {len(paths)} photos beside the views; {room}")
    return paths


def _held_out(
    request: Request, photos: Sequence[Path], reference: Point, console: Console
) -> tuple[list[Picture], dict[str, Any] | None]:
    """The held-out photos as pictures, and where they were taken."""
    if not request.holdout:
        return [], None
    paths = held_out_photos(request, photos)
    size = reference.size
    # Two views are the least that can be loaded; the first is there for company.
    loaded = load_photos([photos[0], *paths], (size, size), request.fov)
    truths = [to_picture(image.transpose(1, 2, 0)) for image in loaded.images[1:]]
    with console.stage("held-out photos"):
        settings = size, request.fov, request.cameras, reference.threads
        poses = held_out_poses(request.model, photos, paths, *settings)
    return truths, poses


def write(request: Request, bench: Bench, rows: Sequence[Row]) -> None:
    """The table on standard output; CSV, JSON and the page in the report's folder."""
    reference, advice = rows[0].point, advise(rows)
    click.echo(to_text(rows))
    for each in advice:
        click.echo(
            f"{each.accuracy} ({each.decibels:g} dB), {each.name}: "
            f"{each.row.seconds['scene']:.3f} s, {each.row.bytes / 1e6:.1f} MB, "
            f"{each.row.worst:.1f} dB: {flags(each.row.point, reference)}"
        )
    about = [
        f"styl3r {__version__}, model {request.model}, {len(bench.photos)} photos, "
        f"{available_cores()} cores of {_processor()}, Python {platform.python_version()}",
        f"styl3r {shlex.join(sys.argv[1:])}",
    ]
    pictures = [_worst_view(bench, row, rows[0]) for row in rows]
    title = f"Speed for accuracy: {bench.photos[0].parent.name}"
    _save(request.output / PAGE, make_page(title, about, rows, advice, pictures))
    _save(request.output / CSV, to_csv(rows))
    report = {
        "about": about,
        "recommended": [_recommended(each, reference) for each in advice],
        "points": [plain(row, reference) for row in rows],
    }
    _save(request.output / JSON, json.dumps(report, indent=2) + "\n")


def _recommended(advice: Advice, reference: Point) -> dict[str, Any]:
    found = {"accuracy": advice.accuracy, "decibels": advice.decibels, "best": advice.name}
    return found | {"flags": flags(advice.row.point, reference), **advice.row.point.to_dict()}


def _save(path: Path, text: str) -> None:
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _worst_view(bench: Bench, row: Row, reference: Row) -> Picture | None:
    """A row's picture that agrees least with the reference's, above that."""
    if not row.views:
        return None
    index = min(range(len(row.views)), key=lambda i: row.views[i].psnr)
    views, all_views = row.point.views, reference.point.views
    with np.load(bench.arrays_of(row.point)) as ours:
        picture = ours["pictures"][index]
    with np.load(bench.arrays_of(reference.point)) as theirs:
        same = index if index < views else all_views + index - views
        return np.concatenate([picture, theirs["pictures"][same]])


def _processor() -> str:
    from styl3r_cli.splatting.timing import machine

    return str(machine()["processor"])
