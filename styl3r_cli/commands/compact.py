"""`styl3r compact`: only as many Gaussians as a scene requires."""

from __future__ import annotations

import re
from decimal import Decimal
from pathlib import Path
from typing import Any

import click

from styl3r_cli.commands.options import (
    STDOUT,
    FileName,
    Number,
    UserPath,
    quiet_option,
    threads_option,
)
from styl3r_cli.quality import KEPT_DECIBELS

UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "ki": 2**10, "mi": 2**20, "gi": 2**30}
HELP = """\
Make a scene several times smaller at no visible loss: leave out what no camera sees, merge what
several photos show of one surface, and simplify what is flat.

\b
  styl3r compact scene.ply -o small.ply
  styl3r compact scene.ply -o small.spz --max-bytes 1MB
  styl3r compact scene.ply -o small.ply --keep-db 38
  styl3r compact foreign.ply -o small.ply --cameras transforms.json

What "no visible loss" means is measured, on renders that the command makes: from the cameras that
came with the scene (or --cameras) and halfway between them, the worst of which differs from the
whole scene by at least --keep-db decibels (PSNR, mean over a black and a white background). 45 is
invisible, 38 shows side by side, 32 at a glance. A scene without cameras is looked at from all
around. What no such camera sees is left out: give cameras where you will look from.
"""


class BytesType(click.ParamType):
    """A number of bytes: 500000, 500kB, 5MB, 1.5MiB."""

    name = "BYTES"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Decimal units, and binary ones with an i."""
        if isinstance(value, int):
            return value
        match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([kmg]i?)?b?", str(value).strip().lower())
        size = int(Decimal(match[1]) * UNITS[match[2] or ""]) if match else 0
        if size < 1:
            self.fail(f"'{value}' is not a size such as 5MB or 800kB", param, ctx)
        return size


@click.command("compact", help=HELP)
@click.argument("source", metavar="SCENE|-")
@click.option(
    "--output",
    "-o",
    required=True,
    type=FileName(),
    metavar="OUT|-",
    help="The compacted scene, in any format; '-' writes a .ply to standard output.",
)
@click.option(
    "--keep-db",
    type=Number(10, 90),
    metavar="DB",
    help=f"Keep this agreement with the whole scene, in decibels (default {KEPT_DECIBELS:g}).",
)
@click.option(
    "--max-gaussians",
    type=click.IntRange(min=1),
    metavar="N",
    help="Keep at most so many Gaussians, as like the whole scene as they can be.",
)
@click.option(
    "--max-bytes",
    type=BytesType(),
    metavar="SIZE",
    help="Make OUT at most so large, such as 5MB, as like the whole scene as it can be.",
)
@click.option("--all", "keep_all", is_flag=True, help="Keep every Gaussian.")
@click.option(
    "--cameras",
    type=UserPath(),
    metavar="FILE",
    help="Where the scene is looked at from (transforms.json); by default its own cameras.",
)
@threads_option
@click.option("--json", "as_json", is_flag=True, help="Print a report as one JSON object.")
@quiet_option
def command(
    source: str,
    output: str,
    keep_db: float | None,
    max_gaussians: int | None,
    max_bytes: int | None,
    keep_all: bool,
    cameras: Path | None,
    threads: int | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Make a scene smaller at no visible loss."""
    from styl3r_cli.commands.compacting import CompactRequest, compact_scene
    from styl3r_cli.errors import UsageError

    wishes = (keep_db, max_gaussians, max_bytes, keep_all or None)
    if sum(wish is not None for wish in wishes) > 1:
        raise UsageError(
            "--keep-db, --max-gaussians, --max-bytes and --all exclude each other; give one"
        )
    if as_json and output == STDOUT:
        raise UsageError("--json and -o - both want standard output; give -o a file's name")
    compact_scene(
        CompactRequest(
            source=source,
            output=output,
            decibels=KEPT_DECIBELS if keep_db is None else keep_db,
            count=max_gaussians,
            size=max_bytes,
            keep_all=keep_all,
            cameras=cameras,
            threads=threads,
            json=as_json,
            quiet=quiet,
        )
    )
