"""`styl3r bench`: how fast this machine is."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from styl3r_cli.commands.options import FILE, STDOUT, Number, SizeType, UserPath, quiet_option
from styl3r_cli.console import Console
from styl3r_cli.errors import UsageError
from styl3r_cli.files import atomic_write
from styl3r_cli.names import user_path

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from styl3r_cli.gaussians import Gaussians

GAUSSIANS = (32_768, 131_072, 524_288)  # a quarter of a scene from 2 photos, 2, and 8
MOST_GAUSSIANS = 100_000_000  # 6 GB; far more than any scene has
SIZES = ((256, 256), (512, 512), (1920, 1080))
REPEATS = 5
TWIN_SECONDS = 20.0

RENDER_HELP = """\
Frames per second of the splat renderer, by Gaussians, frame size and threads.

\b
  styl3r bench render
  styl3r bench render scene.ply --sizes 256,640x480 --threads 1,2 --json times.json
  styl3r bench render --profile --twin-seconds 0

Without SCENE, a scene that is the same on every machine is drawn. Repeats of all cases are
interleaved and their medians printed. Where the extra 'export' is installed, the same formula
written in plain torch stands beside it; and where Mitsuba 3 is (pip install mitsuba, and an LLVM
that suits it), its frames of the same Gaussians, with one ray a pixel. No other kept package from
pip was found that draws Gaussians without a GPU; gsplat does not.
"""


class ListOf(click.ParamType):
    """Values of another type, with commas between them."""

    def __init__(self, each: click.ParamType) -> None:
        self.each = each
        self.name = f"{each.name},..."

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[object, ...]:
        """A value for each part."""
        if isinstance(value, tuple):
            return value
        return tuple(self.each.convert(part, param, ctx) for part in str(value).split(","))


@click.group("bench")
def command() -> None:
    """Measure how fast this machine is."""


@command.command("render", help=RENDER_HELP)
@click.argument("scene", required=False, type=FILE, metavar="[SCENE]")
@click.option(
    "--gaussians",
    type=ListOf(click.IntRange(1, MOST_GAUSSIANS)),
    metavar="N,...",
    help="How many; by default all of SCENE's, or " + ",".join(map(str, GAUSSIANS)) + ".",
)
@click.option(
    "--sizes",
    type=ListOf(SizeType()),
    default=SIZES,
    metavar="WxH,...",
    help="Frames; by default 256,512,1920x1080.",
)
@click.option(
    "--threads",
    type=ListOf(click.IntRange(min=1)),
    metavar="N,...",
    help="By default 1 and every core.",
)
@click.option(
    "--repeats", type=click.IntRange(min=1), default=REPEATS, show_default=True, metavar="N"
)
@click.option(
    "--twin-seconds",
    type=Number(min=0),
    default=TWIN_SECONDS,
    show_default=True,
    help="The longest frame that the torch twin draws; times of longer ones are foretold from a "
    "few pixels and marked '~'. Mitsuba's repeats end after so long. 0 leaves both out.",
)
@click.option(
    "--first-frame", is_flag=True, help="Also the first frame of a process without compiled code."
)
@click.option("--profile", is_flag=True, help="Also where the time of each frame goes.")
@click.option("--json", "json_path", type=UserPath(), metavar="OUT.json", help="The same as JSON.")
@quiet_option
def render_command(
    scene: str | None,
    gaussians: tuple[int, ...] | None,
    sizes: tuple[tuple[int, int], ...],
    threads: tuple[int, ...] | None,
    repeats: int,
    twin_seconds: float,
    first_frame: bool,
    profile: bool,
    json_path: Path | None,
    quiet: bool,
) -> None:
    """Frames per second of the splat renderer."""
    from styl3r_cli import __version__
    from styl3r_cli.commands.checks import check_outputs, check_suffix
    from styl3r_cli.splatting import timing
    from styl3r_cli.splatting.profiling import stage_seconds

    console = Console(quiet)
    read = [] if scene in (None, STDOUT) else [user_path(scene)]
    if json_path is not None:  # where it takes no file, as in other commands, a scene may follow
        check_suffix(json_path, ".json", "--json")
    check_outputs([json_path] if json_path else [], read, prints=True)
    scenes, view = _scenes(scene, gaussians, console)
    cores = threads or tuple(sorted({1, timing.default_threads()}))
    cameras = [timing.camera_of(width, height, view) for width, height in sizes]
    if not timing.has_twin() and twin_seconds:
        console.note("without the torch twin; it needs: pip install 'styl3r[export]'")
    total = repeats * len(scenes) * len(cameras) * len(cores)
    with console.stage("frames", total) as done:
        cases = timing.measure(
            scenes, cameras, list(cores), repeats, twin_seconds, done, console.note
        )
        rows = []
        for case in cases:
            row = case.row()
            if profile and case.renderer == timing.RENDERER:
                parts = stage_seconds(case.scene, case.camera, case.threads, repeats)
                row["stages"] = {name: 1e3 * seconds for name, seconds in parts.items()}
            rows.append(row)
    report: dict[str, Any] = {"version": __version__, "scene": scene or "synthetic"}
    report["machine"] = timing.machine()
    if first_frame:
        with console.stage("first frame"):
            report["first_frame_seconds"] = timing.seconds_to_first_frame()
    click.echo(_table(rows))
    if profile:
        click.echo("\n" + _profile_table(rows))
    if first_frame:
        click.echo(f"first frame with nothing compiled: {report['first_frame_seconds']:.2f} s")
    if json_path is not None:
        with atomic_write(json_path) as temporary:
            temporary.write_text(json.dumps(report | {"rows": rows}, indent=2) + "\n")


def _scenes(
    source: str | None, counts: tuple[int, ...] | None, console: Console
) -> tuple[list[Gaussians], NDArray[np.float64] | None]:
    """What to draw, and the extrinsics to draw it from if the scene says so."""
    from styl3r_cli.cameras.stored import cameras_from_metadata
    from styl3r_cli.commands.scene_file import load
    from styl3r_cli.splatting import timing

    if source is None:
        return [timing.synthetic_scene(count) for count in counts or GAUSSIANS], None
    with console.stage("read"):
        scene = load(source).scene
    whole = len(scene.gaussians)
    for note in scene.notes:
        console.note(note)
    if counts and max(counts) > whole:
        raise UsageError(f"--gaussians {max(counts)}: {source} has {whole}")
    cameras = cameras_from_metadata(scene.metadata)
    view = cameras[0].extrinsics if cameras else None
    return [timing.some_of(scene.gaussians, count) for count in counts or (whole,)], view


def _table(rows: list[dict[str, Any]]) -> str:
    """A line per case, with how many times faster than the twin it is."""
    from styl3r_cli.splatting.timing import TWIN

    keys = ("gaussians", "width", "height", "threads")
    twins = {tuple(r[k] for k in keys): r for r in rows if r["renderer"] == TWIN}
    lines = [
        f"{'':10}  Gaussians      frame  threads    ms a frame   ms of cores        fps   x twin"
    ]
    for row in rows:
        twin = twins.get(tuple(row[key] for key in keys))
        mark = "~" if row["foretold"] else ""
        ratio = f"{twin['milliseconds'] / row['milliseconds']:,.0f}" if twin else ""
        lines.append(
            f"{row['renderer']:10}{row['gaussians']:>11,}{row['width']:>7}x{row['height']:<5}"
            f"{row['threads']:>5}{mark + format(row['milliseconds'], ',.1f'):>14}"
            f"{mark + format(row['processor_milliseconds'], ',.1f'):>14}"
            f"{mark + format(row['fps'], ',.4g'):>11}{ratio:>9}"
        )
    return "\n".join(lines)


def _profile_table(rows: list[dict[str, Any]]) -> str:
    """A line per case: milliseconds of each stage."""
    profiled = [row for row in rows if "stages" in row]
    names = list(profiled[0]["stages"])
    lines = ["Gaussians      frame  threads" + "".join(f"{name:>12}" for name in names)]
    for row in profiled:
        lines.append(
            f"{row['gaussians']:>9,}{row['width']:>7}x{row['height']:<5}{row['threads']:>5}  "
            + "".join(f"{row['stages'][name]:>12.2f}" for name in names)
        )
    return "\n".join(lines)
