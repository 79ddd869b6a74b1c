"""`styl3r tradeoff`: what every setting costs and gives, on the user's own photos."""

from __future__ import annotations

from typing import Any

import click

from styl3r_cli.commands.bench import ListOf
from styl3r_cli.commands.options import FILE, STDOUT, Number, UserPath, quiet_option
from styl3r_cli.errors import UsageError
from styl3r_cli.tradeoff.points import COLOURS, DRAWINGS

PRECISIONS = ("w8", "w4", "int8", "int8-static", "mixed")
SIZES = (256, 224, 192, 160, 128)
BUDGETS = (100.0, 50.0, 25.0, 10.0, 5.0, 2.0)
REPEATS = 3

HELP = """\
Measure what speed costs in accuracy on this machine, with these photos.

\b
  styl3r tradeoff photos/ --style art.jpg -o report/
  styl3r tradeoff photos/ --style art.jpg --holdout other/ -o report/
  styl3r tradeoff photos/ --holdout other/ --lpips lpips.onnx -o report/
  styl3r tradeoff photos/ --cameras transforms.json -o report/
  styl3r tradeoff photos/ -o report/ --precisions w8,int8 --sizes 256,128 --budgets 100,10 --grid

Each dial (precision of the graphs, size of the photos, number of views, share of the Gaussians,
drawing, cores, colours) is turned alone, from the first of its values; --grid measures all
combinations.
Every measurement is a process of its own, with a warm-up, and repeats are interleaved, so that a
busy minute strikes all alike.

The report is index.html (table, plots, pictures), tradeoff.csv and tradeoff.json. The same command
goes on where an interrupted one stopped; Ctrl-C writes the report of what there is.

Agreement is PSNR against the first of all values. A precision below 30 dB in any view, or one that
gives no finite scene, is shown as rejected and never recommended. With --holdout, PSNR and SSIM of
pictures from the held-out photos' places are there too, with --cameras how far the found cameras
are off: in degrees, as medians over the views, from the first view. Where TRANSFORMS.json names
depth pictures (depth_file_path, as the LiDAR apps' exports have it), so is how far depths are off:
AbsRel and the share within a factor of 1.25, after one scale for all views. LPIPS takes a network
whose weights do not come with styl3r; python -m styl3r_export.evaluate.lpips makes NET.onnx of
them. Bfloat16 is no precision here: onnxruntime has no convolutions and matrix products in it for
CPUs.
"""


@click.command("tradeoff", help=HELP)
@click.argument("photos", nargs=-1, required=True, metavar="PHOTOS...")
@click.option(
    "--style", "-s", "styles", type=UserPath(), multiple=True, help="Without one: own colours."
)
@click.option("--output", "-o", required=True, type=UserPath(), metavar="REPORT", help="A folder.")
@click.option(
    "--holdout",
    type=FILE,
    multiple=True,
    metavar="FOLDER|PHOTO",
    help="Photos of the same scene that the network does not get, to compare with as truth.",
)
@click.option(
    "--lpips",
    type=UserPath(),
    metavar="NET.onnx",
    help="Measure LPIPS of the held-out photos too, by this graph.",
)
@click.option(
    "--cameras",
    type=UserPath(),
    metavar="TRANSFORMS.json",
    help="Where the photos were taken from, to compare the found cameras and depths with; focal "
    "lengths in it are used as `stylize --cameras` does.",
)
@click.option(
    "--model",
    type=FILE,
    default="mini",
    show_default=True,
    metavar="NAME|DIR",
    help="The network.",
)
@click.option(
    "--precisions",
    type=ListOf(click.Choice(["fp32", "fp16", *PRECISIONS])),
    default=PRECISIONS,
    metavar="NAME,...",
    help="Beside the model as given; see `styl3r export --help`. By default "
    + ",".join(PRECISIONS)
    + ".",
)
@click.option(
    "--sizes",
    type=ListOf(click.IntRange(16, 4096)),
    default=SIZES,
    metavar="SIDE,...",
    help="By default " + ",".join(map(str, SIZES)) + ".",
)
@click.option(
    "--views",
    type=ListOf(click.IntRange(2, 8)),
    metavar="N,...",
    help="The first so many photos. By default all, then fewer down to 2.",
)
@click.option(
    "--budgets",
    type=ListOf(Number(0, 100, min_open=True)),
    default=BUDGETS,
    metavar="PERCENT,...",
    help="By default " + ",".join(f"{each:g}" for each in BUDGETS) + ".",
)
@click.option(
    "--drawings",
    type=ListOf(click.Choice(DRAWINGS)),
    default=DRAWINGS,
    metavar="NAME,...",
    help="exact, antialias, balanced, draft: as `render --antialias` and `render --quality` draw.",
)
@click.option(
    "--colours",
    type=ListOf(click.Choice(COLOURS)),
    default=COLOURS,
    metavar="NAME,...",
    help="fitted, plain: as `stylize --quality best` and `balanced` make them.",
)
@click.option(
    "--threads",
    type=ListOf(click.IntRange(min=1)),
    metavar="N,...",
    help="By default every core, and 1.",
)
@click.option("--grid", is_flag=True, help="All combinations.")
@click.option("--repeats", type=click.IntRange(1), default=REPEATS, show_default=True)
@click.option("--fov", type=float, metavar="DEGREES", help="As for `stylize`.")
@quiet_option
def command(**options: Any) -> None:
    """Measure what speed costs in accuracy on this machine, with these photos."""
    from styl3r_cli.tradeoff.report import Request, run

    if STDOUT in (*options["photos"], *options["holdout"]):
        raise UsageError(f"{STDOUT}: a trade-off takes no list of photos; name files or folders")
    run(Request(**options))
