"""`styl3r export`: a checkpoint, or the bundled model, becomes a folder of verified graphs."""

from __future__ import annotations

import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import click

from styl3r_cli.commands.checks import check_printable
from styl3r_cli.commands.options import FileName, UserPath, quiet_option
from styl3r_cli.console import Console
from styl3r_cli.errors import UsageError
from styl3r_cli.manifest import Manifest, sha256_of
from styl3r_cli.names import real_path, user_path

if TYPE_CHECKING:
    from styl3r_export.graphs_metadata import Provenance
    from styl3r_export.model import Styl3r
    from styl3r_export.onnx_export import Precision
    from styl3r_export.quantise.calibration import Sample

# Modules of the extra `export` that tracing and writing need, and that quantising does.
NEEDED = ("torch", "onnx", "onnxscript", "jaxtyping")
NEEDED_TO_QUANTISE = ("onnx", "onnx_ir")
TRACED = ("fp32", "fp16")  # written by torch's exporter; the others are made from these

HELP = """\
Turn a checkpoint into a model folder for --model, and check it against torch; or a model folder
into one of another precision, and compare pictures of both.

\b
  styl3r export re10k_2v.ckpt -o models/re10k_2v --precision fp16
  styl3r export mini -o models/mini
  styl3r export mini -o models/mini_int8 --precision int8 --photos room/ --style art.jpg
  styl3r export models/re10k_2v -o models/re10k_2v_static --precision int8-static --photos room/

CHECKPOINT is a published Styl3R checkpoint, a checkpoint of this project's training, the name of
a bundled model, or a folder that this command wrote. Nothing in a checkpoint is executed.

\b
Precisions:
  fp32         float32
  fp16         weights in half precision; computed in float32
  w8           weights in 8 bits, a scale a channel; computed in float32
  w4           matrices in 4 bits, convolutions in 8; computed in float32
  int8         matrix products in 8-bit integers, ranges found as it runs
  int8-static  int8, and the heads' convolutions with ranges calibrated on --photos
  mixed        int8-static, but for what decides where Gaussians are: float32
Normalisation, softmax, exponential depth, and every head's last layer and activation stay float32.
A precision whose pictures keep less than 30 dB of the original's in any view is refused.
"""


@click.command("export", help=HELP)
@click.argument("checkpoint", metavar="CHECKPOINT|mini|DIR")
@click.option(
    "--output",
    "-o",
    required=True,
    type=UserPath(),
    metavar="DIR",
    help="A new folder, or an earlier export to replace.",
)
@click.option(
    "--precision",
    type=click.Choice(["fp32", "fp16", "w8", "w4", "int8", "int8-static", "mixed"]),
    default="fp32",
    show_default=True,
    help="How weights are stored, and what is computed in integers; see above.",
)
@click.option(
    "--photos",
    multiple=True,
    type=FileName(),
    metavar="FOLDER|GLOB",
    help="Photos of one scene, to calibrate on and to compare pictures of; again for more scenes.",
)
@click.option(
    "--style",
    "styles",
    multiple=True,
    type=UserPath(),
    help="A style for those scenes; without one they keep their own colours.",
)
@click.option(
    "--verify/--no-verify",
    default=True,
    help="Compare with torch, or pictures with the original's, before anything is written (the "
    "default).",
)
@quiet_option
def command(
    checkpoint: str,
    output: Path,
    precision: str,
    photos: tuple[str, ...],
    styles: tuple[Path, ...],
    verify: bool,
    quiet: bool,
) -> None:
    """Turn a checkpoint into a model folder, and check it."""
    if verify:
        check_printable()
    _keep_source(checkpoint, output)
    console = Console(quiet)
    from_folder = not Path(checkpoint).expanduser().is_file()
    if precision in TRACED or not from_folder:
        _require(NEEDED)
    if precision in TRACED:
        if photos or styles:
            raise UsageError(f"--photos and --style are for quantised models, not {precision}")
        manifest = _trace(checkpoint, output, precision, verify, console)
    else:
        _require(NEEDED_TO_QUANTISE)
        from styl3r_cli.graphs import find

        with tempfile.TemporaryDirectory() as folder:
            source = find(checkpoint) if from_folder else Path(folder) / "traced"
            samples = _samples(photos, styles, precision, console)
            if not from_folder:
                _trace(checkpoint, source, "fp32", verify, console)
            manifest = _quantise(source, output, precision, samples, verify, console)
    size = sum(entry.bytes for entry in manifest.files.values())
    console.note(f"{output}: {manifest.model}, {precision}, {size / 1e6:.1f} MB")


def _keep_source(checkpoint: str, output: Path) -> None:
    """Refuse to replace the model that another is made from."""
    from styl3r_cli.graphs import BUNDLED

    sources = {real_path(user_path(checkpoint)), real_path(BUNDLED / checkpoint)}
    if real_path(output) in sources:
        raise UsageError(f"{output} is also an input; results never replace what they come from")


def _require(modules: tuple[str, ...]) -> None:
    missing = [name for name in modules if find_spec(name) is None]
    if missing:
        raise UsageError(
            f"export needs {', '.join(missing)}; install them with: pip install 'styl3r[export]'"
        )


def _trace(
    checkpoint: str, output: Path, precision: Precision | str, verify: bool, console: Console
) -> Manifest:
    """Graphs from a torch model, compared with it."""
    from styl3r_export.export_graphs import check_finite, export_graphs
    from styl3r_export.quantise.folders import check_target
    from styl3r_export.verify import CASES, table, worst_of_each_output

    check_target(output)
    with console.stage("reading"):
        model, provenance = read_model(checkpoint)
        check_finite(model)
    report = export_graphs(
        model,
        output,
        "fp16" if precision == "fp16" else "fp32",
        provenance=provenance,
        cases=CASES if verify else (),
        stage=console.stage,
    )
    if report.rows:
        click.echo("onnxruntime against torch")
        click.echo(table(report.rows))
    if report.losses:
        click.echo("\nrounded weights against the checkpoint's, both in torch: the worst cases")
        click.echo(table(worst_of_each_output(report.losses)))
    return report.manifest


def _samples(
    photos: tuple[str, ...], styles: tuple[Path, ...], precision: str, console: Console
) -> list[Sample]:
    """A sample for each set of photos; the made-up one if there are none."""
    from styl3r_cli.photos import expand, load_photos, load_style
    from styl3r_export.quantise.calibration import Sample, made_up
    from styl3r_export.quantise.variants import VARIANTS

    if VARIANTS[precision].calibrated and not photos:
        raise UsageError(f"--precision {precision} is calibrated on photos; add --photos FOLDER")
    pictures = [load_style(style).image for style in styles]
    if not photos:
        console.note("pictures of a made-up scene are compared; --photos FOLDER takes real ones")
        return [made_up()]
    samples = []
    for name in photos:
        with console.stage("photos"):
            views = load_photos(expand([name], [], []))
        samples.append(Sample(Path(name).name or name, views, pictures))
    return samples


def _quantise(
    source: Path,
    output: Path,
    precision: str,
    samples: list[Sample],
    verify: bool,
    console: Console,
) -> Manifest:
    """Graphs from other graphs, compared in pictures."""
    from styl3r_export.quantise.folders import convert_folder
    from styl3r_export.quantise.loss import table

    manifest, losses = convert_folder(
        source, output, precision, samples, verify=verify, stage=console.stage
    )
    if losses:
        click.echo("pictures, and relative errors of the Gaussians, against the original's")
        click.echo(table(losses))
    return manifest


def read_model(checkpoint: str) -> tuple[Styl3r, Provenance]:
    """The model behind what the user named, and where its weights came from.

    Raises:
        ModelError: there is no model of that name, or the folder is no export.
        InputError: the file is no checkpoint.
    """
    from styl3r_cli.graphs import find
    from styl3r_export.checkpoints import load_any
    from styl3r_export.graphs_metadata import OWN_LICENCE, PUBLISHED_LICENCE, Provenance
    from styl3r_export.graphs_reading import load_graphs

    path = Path(checkpoint).expanduser()
    if not path.is_file():
        return load_graphs(find(checkpoint))
    model = load_any(path)
    licence = PUBLISHED_LICENCE if model.config.name == "full" else OWN_LICENCE
    return model, Provenance(path.stem, licence, sha256_of(path))
