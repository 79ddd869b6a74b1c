"""How a compacted scene looks as its file has it: formats round, and promises are of files."""

from __future__ import annotations

from dataclasses import replace

from styl3r_cli.compaction import Compaction, measured
from styl3r_cli.errors import InputError
from styl3r_cli.formats import Encoded, read_scene
from styl3r_cli.gaussians import Gaussians

EXACT = (".ply", ".glb")  # what they change, they say in a note
NEVER_READ = (".points.glb",)


def as_written(
    made: Compaction, whole: Gaussians, encoded: Encoded, suffix: str, threads: int | None
) -> Compaction:
    """The compaction with the decibels of what the file holds.

    Args:
        made: from the whole scene.
        whole: the scene.
        encoded: the file.
        suffix: its format; of one that has no Gaussians to draw, there are no decibels.
        threads: None for every core.

    Raises:
        InputError: nothing is left in the file.
    """
    if not len(made.gaussians):
        raise InputError(
            f"no camera that judges it sees any of its {len(whole)} Gaussians: none would be left"
        )
    if not encoded.count:
        raise InputError(f"none of its {len(whole)} Gaussians can be kept in a {suffix}")
    if suffix in NEVER_READ:
        return replace(made, decibels=[])
    if suffix in EXACT and not encoded.notes:
        return made
    stored = read_scene(encoded.data, suffix).gaussians
    return replace(made, decibels=measured(whole, stored, made.cameras, threads))


def broken_promise(made: Compaction, suffix: str, decibels: float) -> list[str]:
    """A note, if the format's rounding costs more than was promised."""
    if not made.decibels or made.worst >= decibels:
        return []
    better = " or ".join(each for each in EXACT if each != suffix)
    return [f"{made.worst:.1f} dB instead of {decibels:g}: {suffix} rounds; a {better} keeps more"]
