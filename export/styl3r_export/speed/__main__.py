"""`python -m styl3r_export.speed CHECKPOINT MODEL... --photos FOLDER --style ART`."""

from __future__ import annotations

import tempfile
from pathlib import Path

import click

from styl3r_cli.manifest import read_manifest
from styl3r_cli.photos import expand
from styl3r_cli.tradeoff.agreement import compare_pictures
from styl3r_export.speed.compare import HEAD, Timed, pictures, row, started, take_turns
from styl3r_export.speed.worker import TORCH

SIDE = 256  # pixels of the pictures that are compared, as of the photos


@click.command()
@click.argument("checkpoint", type=click.Path(exists=True, dir_okay=False))
@click.argument("models", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
@click.option("--photos", required=True, help="A folder or glob; the first --views of them.")
@click.option("--style", required=True, help="A style picture.")
@click.option("--views", default=2, show_default=True, help="How many photos.")
@click.option("--repeats", default=5, show_default=True, help="Passes each, after one to warm up.")
@click.option("--keep", type=click.Path(path_type=Path), help="A folder for the pictures.")
def main(
    checkpoint: str,
    models: tuple[Path, ...],
    photos: str,
    style: str,
    views: int,
    repeats: int,
    keep: Path | None,
) -> None:
    """Time a network's exported MODEL folders beside the same network in torch (float32, eager).

    Everything runs on every core, in a process of its own. Torch and each model take turns, so
    that a busy machine slows both; "faster" is the median of the turns' ratios, "less CPU" that of
    their processor time, memory the largest that a process held. The pictures are from torch's
    cameras and from between them.
    """
    names = [str(path) for path in expand([photos], [], [])[:views]]
    job = {"checkpoint": checkpoint, "photos": names, "styles": [style]}
    print(HEAD)
    with tempfile.TemporaryDirectory() as folder, started(job | {"kind": TORCH}) as torch:
        reference = Timed(TORCH, torch.load_seconds)
        torch.run()
        truth = Path(folder) / "torch.npz"
        torch.save(truth)
        wanted = pictures(truth, truth, (SIDE, SIDE))
        _keep(keep, TORCH, wanted)
        for model in models:
            with started(job | {"kind": str(model)}) as worker:
                timed = take_turns(model.name, worker, torch, repeats)
                worker.save(Path(folder) / "model.npz")
            reference.passes += timed.beside
            seen = pictures(Path(folder) / "model.npz", truth, (SIDE, SIDE))
            _keep(keep, model.name, seen)
            size = sum(entry.bytes for entry in read_manifest(model).files.values())
            print(row(timed, reference, compare_pictures(seen, wanted, len(names)), size))
        reference.beside = reference.passes
        print(row(reference, reference, [], Path(checkpoint).stat().st_size))


def _keep(folder: Path | None, name: str, seen: list) -> None:
    if folder is None:
        return
    from PIL import Image

    folder.mkdir(parents=True, exist_ok=True)
    for index, picture in enumerate(seen):
        Image.fromarray(picture).save(folder / f"{name}_{index}.png")


if __name__ == "__main__":
    main()
