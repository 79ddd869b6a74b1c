"""Command line: `python -m styl3r_export.scenes` writes shards or a contact sheet."""

import multiprocessing
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import click

from styl3r_cli.errors import ExitCode
from styl3r_export.scenes.generate import KINDS
from styl3r_export.scenes.shards import SHARD_SCENES, Plan, write_shard
from styl3r_export.scenes.sheet import write_sheet
from styl3r_export.scenes.textures import TextureBank

SOME = click.IntRange(1)


@click.command(help="Generate training scenes with exact cameras and depth.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for shards.")
@click.option(
    "--sheet", type=click.Path(path_type=Path), help="Write a contact sheet (PNG) instead."
)
@click.option(
    "--count",
    type=SOME,
    default=SHARD_SCENES,
    show_default=True,
    help="Scenes, filled up to whole shards.",
)
@click.option("--seed", default=0, show_default=True)
@click.option("--views", type=SOME, default=6, show_default=True, help="Photographs per scene.")
@click.option(
    "--size", type=SOME, default=256, show_default=True, help="Side of the square photographs."
)
@click.option(
    "--textures",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Folder of pictures; without it patterns are drawn.",
)
@click.option("--workers", type=SOME, default=1, show_default=True, help="Processes.")
@click.option("--kind", type=click.Choice(list(KINDS)), help="Only for --sheet: one kind of scene.")
def main(
    out: Path | None, sheet: Path | None, count: int, seed: int, views: int, size: int,
    textures: Path | None, workers: int, kind: str | None,
) -> None:  # fmt: skip
    """Write shards or a sheet."""
    if (out is None) == (sheet is None):
        raise click.UsageError("give either --out FOLDER or --sheet PNG")
    bank = TextureBank.from_folder(textures) if textures else TextureBank.procedural(0)
    plan = Plan(seed, views, (size, size), min(SHARD_SCENES, count))
    try:
        if sheet is not None:
            write_sheet(sheet, count, seed, views, (size, size), bank, kind)
        elif out is not None:
            out.mkdir(parents=True, exist_ok=True)
            write_shards(out, plan, count, bank, workers)
    except OSError as error:
        print(f"Error: cannot write {out or sheet}: {error.strerror or error}", file=sys.stderr)
        sys.exit(ExitCode.OUTPUT)


def write_shards(out: Path, plan: Plan, count: int, bank: TextureBank, workers: int) -> None:
    """Whole shards of at least `count` scenes, with their progress on standard error."""
    shards, begin, made = -(-count // plan.scenes), time.monotonic(), 0
    # Forked workers share the bank's memory.
    context = multiprocessing.get_context("fork")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        jobs = [pool.submit(write_shard, out, k, plan, bank) for k in range(shards)]
        for done, job in enumerate(as_completed(jobs), 1):
            made += job.result() * plan.scenes
            rate = made / (time.monotonic() - begin)
            print(f"\r{done}/{shards} shards, {rate:.2f} scenes/s", end="", file=sys.stderr)
    print(file=sys.stderr)


if __name__ == "__main__":
    main()
