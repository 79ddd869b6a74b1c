"""`styl3r export`: a checkpoint, or the bundled model, becomes a folder of verified graphs."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from styl3r_cli.commands.options import UserPath, quiet_option
from styl3r_cli.console import Console
from styl3r_cli.errors import UsageError
from styl3r_cli.manifest import sha256_of

if TYPE_CHECKING:
    from styl3r_export.graphs_metadata import Provenance
    from styl3r_export.model import Styl3r

# Modules of the extra `export` that tracing and writing need.
NEEDED = ("torch", "onnx", "onnxscript", "jaxtyping")

HELP = """\
Turn a checkpoint into a model folder for --model, and check it against torch.

\b
  styl3r export re10k_2v.ckpt -o models/re10k_2v --precision fp16
  styl3r export mini -o models/mini

CHECKPOINT is a published Styl3R checkpoint, a checkpoint of this project's training, the name of
a bundled model, or a folder that this command wrote. Nothing in a checkpoint is executed.
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
    type=click.Choice(["fp32", "fp16"]),
    default="fp32",
    show_default=True,
    help="How weights are stored: fp16 halves the files; computation stays float32.",
)
@click.option(
    "--verify/--no-verify",
    default=True,
    help="Compare onnxruntime with torch before anything is written (the default).",
)
@quiet_option
def command(
    checkpoint: str, output: Path, precision: Literal["fp32", "fp16"], verify: bool, quiet: bool
) -> None:
    """Turn a checkpoint into a model folder, and check it against torch."""
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise UsageError(
            f"export needs {', '.join(missing)}; install them with: pip install 'styl3r[export]'"
        )
    from styl3r_export.export_graphs import check_finite, check_target, export_graphs
    from styl3r_export.verify import CASES, table, worst_of_each_output

    console = Console(quiet)
    check_target(output)
    with console.stage("reading"):
        model, provenance = read_model(checkpoint)
        check_finite(model)
    report = export_graphs(
        model,
        output,
        precision,
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
    size = sum(entry.bytes for entry in report.manifest.files.values())
    console.note(f"{output}: {report.manifest.model}, {precision}, {size / 1e6:.1f} MB")


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
