"""What `compact` does: a scene in; fewer Gaussians, and what that costs, out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.stored import cameras_from_metadata
from styl3r_cli.commands.checks import check_outputs, check_stdout
from styl3r_cli.commands.options import STDOUT
from styl3r_cli.commands.report import compaction_report, print_report
from styl3r_cli.commands.scene_file import SceneFile, load
from styl3r_cli.commands.written import as_written, broken_promise
from styl3r_cli.compaction import Compaction, Compactor, everything, witnesses
from styl3r_cli.console import Console
from styl3r_cli.errors import InputError, UsageError
from styl3r_cli.files import atomic_write, write_stdout
from styl3r_cli.formats import Encoded, Scene, encode_scene, scene_suffix

# Encoded sizes are nearly proportional to the number of Gaussians; a few corrections reach them.
SIZE_ATTEMPTS = 6
SIZE_MARGIN = 0.995


@dataclass(frozen=True)
class CompactRequest:
    """The options of `compact`; of `count`, `size` and `keep_all` at most one is set."""

    source: str
    output: str
    decibels: float
    count: int | None
    size: int | None
    keep_all: bool
    cameras: Path | None
    threads: int | None
    json: bool
    quiet: bool

    @property
    def path(self) -> Path | None:
        """Where the scene goes; None for standard output."""
        return None if self.output == STDOUT else Path(self.output).expanduser()

    @property
    def suffix(self) -> str:
        """The format that it gets."""
        return ".ply" if self.path is None else scene_suffix(self.path)


def compact_scene(request: CompactRequest) -> None:
    """Read, compact, write and report.

    Raises:
        Styl3rError: an input or output is unusable, or a promise cannot be kept.
    """
    console = Console(request.quiet)
    _check(request)
    with console.stage("read"):
        file = load(request.source)
    scene = file.scene
    for note in scene.notes:
        console.note(note)
    if not len(scene.gaussians):
        raise InputError(f"{request.source}: it holds no Gaussians")
    views = _views(request, scene, console)
    with console.stage("compact"):
        made, encoded = _compact(request, scene, views, console)
        made = as_written(made, scene.gaussians, encoded, request.suffix, request.threads)
    with console.stage("write"):
        if request.path is None:
            write_stdout(encoded.data)
        else:
            with atomic_write(request.path) as temporary:
                temporary.write_bytes(encoded.data)
    promised = request.count is None and request.size is None
    broken = broken_promise(made, request.suffix, request.decibels) if promised else []
    for note in [*encoded.notes, *broken]:
        console.note(note)
    report = _report(request, file, made, encoded, console)
    console.note(_summary(report))
    if request.json:
        print_report(report)


def _check(request: CompactRequest) -> None:
    read = [] if request.source == STDOUT else [Path(request.source).expanduser()]
    if request.cameras is not None:
        read.append(request.cameras)
    if request.path is None:
        check_stdout("-o -")
    else:
        scene_suffix(request.path)
        check_outputs([request.path], read, prints=request.json)


def _views(request: CompactRequest, scene: Scene, console: Console) -> list[Camera]:
    """Where the scene is looked at from; none if nothing says."""
    if request.cameras is not None:
        from styl3r_cli.cameras.camera_path import read_cameras

        file = read_cameras(request.cameras)
        for note in file.notes:
            console.note(note)
        return file.cameras
    views = cameras_from_metadata(scene.metadata)
    if not views and not request.keep_all:
        console.note(
            "the scene came without cameras: judged from all around it (--cameras tells better)"
        )
    return views


def _compact(
    request: CompactRequest, scene: Scene, views: list[Camera], console: Console
) -> tuple[Compaction, Encoded]:
    gaussians, threads = scene.gaussians, request.threads
    if request.keep_all:
        made = everything(gaussians, [])
        return made, encode_scene(gaussians, scene.metadata, request.suffix)
    judges = witnesses(views, gaussians)
    compactor = Compactor(gaussians, judges, threads)
    asked, drawn = (max(camera.width for camera in each) for each in (judges, compactor.cameras))
    if drawn < asked:
        console.note(
            f"judged from frames {drawn} pixels wide, not {asked}: so much is behind each pixel "
            "that larger ones would take too much memory"
        )
    if request.size is not None:
        return _within(request, scene, compactor, request.size)
    if request.count is not None:
        made = compactor.keep_count(gaussians.colours, request.count)
    else:
        made = compactor.keep_decibels(gaussians.colours, request.decibels)
    return made, encode_scene(made.gaussians, scene.metadata, request.suffix)


def _within(
    request: CompactRequest, scene: Scene, compactor: Compactor, size: int
) -> tuple[Compaction, Encoded]:
    """As many Gaussians as fit into a file of that size."""
    whole = len(encode_scene(scene.gaussians, scene.metadata, request.suffix).data)
    count = len(scene.gaussians) * size // whole
    for _ in range(SIZE_ATTEMPTS):
        if count < 1:
            break
        made = compactor.keep_count(scene.gaussians.colours, count)
        encoded = encode_scene(made.gaussians, scene.metadata, request.suffix)
        if len(encoded.data) <= size:
            return made, encoded
        count = int(len(made.gaussians) * size / len(encoded.data) * SIZE_MARGIN)
    raise UsageError(f"--max-bytes: no scene of a {request.suffix} is as small as {size} bytes")


def _report(
    request: CompactRequest,
    file: SceneFile,
    made: Compaction,
    encoded: Encoded,
    console: Console,
) -> dict[str, object]:
    """What was kept and what was measured, as plain values."""
    return {
        "source": request.source,
        "output": request.output,
        **compaction_report(made),
        "gaussians": {"before": len(file.scene.gaussians), "after": encoded.count},
        "kept": encoded.count / len(file.scene.gaussians),
        "bytes": {"before": file.size, "after": len(encoded.data)},
        "seconds": {name: round(value, 4) for name, value in console.timings.items()},
        "notes": console.notes,
    }


def _summary(report: dict[str, object]) -> str:
    """One line of it."""
    counts, sizes = report["gaussians"], report["bytes"]
    assert isinstance(counts, dict)
    assert isinstance(sizes, dict)
    line = (
        f"{counts['after']:,} of {counts['before']:,} Gaussians kept"
        f" ({100 * counts['after'] / counts['before']:.1f} %),"
        f" {sizes['after'] / 1e6:.2f} of {sizes['before'] / 1e6:.2f} MB"
    )
    if report["worst_db"] is None:
        return line
    return (
        f"{line}; {report['worst_db']:.1f} dB at the worst of {report['cameras']} cameras,"
        f" {report['mean_db']:.1f} on average"
    )
