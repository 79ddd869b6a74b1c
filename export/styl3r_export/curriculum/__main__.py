"""`python -m styl3r_export.curriculum STAGE`: train one stage, from a checkpoint or from new."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from pathlib import Path

import torch

from styl3r_export.curriculum import data, stages
from styl3r_export.curriculum.novel_views import NovelViewStep
from styl3r_export.curriculum.perceptual import load_perceptual
from styl3r_export.curriculum.pictures import PictureBank, flat_batches, training_pictures
from styl3r_export.curriculum.stylization import StyleBatch, StyleStep, Teacher, style_batches
from styl3r_export.curriculum.teachers import initialise_flow, initialise_strokes
from styl3r_export.curriculum.trainer import Schedule, Trainer


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="styl3r_export.curriculum", description=__doc__)
    parser.add_argument("stage", choices=["geometry", "novel-views", "style"])
    parser.add_argument("--data", type=Path, required=True, help="folder of scene shards")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument("--start", type=Path, help="checkpoint to start from")
    parser.add_argument("--flow", type=Path, help="RAFT-small weights (.npz) for a new network")
    parser.add_argument("--styles", type=Path, help="folder of paintings")
    parser.add_argument("--style-sources", type=Path, help="CSV naming public-domain paintings")
    parser.add_argument("--photos", type=Path, help="folder of photographs")
    parser.add_argument("--perceptual", type=Path, help="VGG weights (.npz slim, .pth torchvision)")
    parser.add_argument("--teacher", type=Path, help="2D stylizer (.onnx) to learn from")
    parser.add_argument("--size", type=int, default=128, help="side of flat scenes and paintings")
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--seconds", type=float, default=math.inf, help="stop after this time")
    parser.add_argument("--batch", type=int, default=16, help="scenes of two views a step")
    parser.add_argument("--views", type=int, nargs="+", default=[2])
    parser.add_argument("--learning-rate", type=float, default=3e-4)
    parser.add_argument(
        "--frozen", action="store_true", help="novel views: leave depths and cameras as they are"
    )
    parser.add_argument("--microast", type=Path, help="MicroAST weights (.npz) for new colours")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--device", default="cpu")
    args = parser.parse_args()
    needs = {"novel-views": ("perceptual",), "style": ("perceptual", "styles", "photos")}
    missing = [f"--{name}" for name in needs.get(args.stage, ()) if getattr(args, name) is None]
    if missing:
        parser.error(f"the {args.stage} stage needs {' and '.join(missing)}")
    return args


def main() -> None:
    """Run the stage; start the same command again to go on."""
    args = parse()
    torch.manual_seed(args.seed)
    # Optimiser states decay to denormal numbers, on which CPUs are up to ten times slower.
    torch.set_flush_denormal(True)
    torch.set_num_threads(args.threads)
    trains = {
        "geometry": stages.geometry_trains,
        "novel-views": stages.attributes_train if args.frozen else stages.novel_views_train,
        "style": stages.appearance_trains,
    }
    trainer = Trainer(
        args.out,
        Schedule(args.steps, learning_rate=args.learning_rate),
        trains[args.stage],
        start=args.start,
        device=args.device,
    )
    if args.flow and trainer.step == 0 and not args.start:
        initialise_flow(trainer.model, args.flow)
    if args.microast and trainer.step == 0 and not args.start:
        initialise_strokes(trainer.model, args.microast)
    seed = args.seed + trainer.step  # a resumed run does not repeat its first batches
    # Not ahead in a thread: batches take a hundredth of a step, and torch's threads of two
    # callers wait for each other, which made steps a third slower.
    scenes = data.batches(args.data, seed, args.batch, tuple(args.views))
    if args.stage == "geometry":
        trainer.run(scenes, stages.geometry_step, seconds=args.seconds)
    elif args.stage == "novel-views":
        step = NovelViewStep(load_perceptual(args.perceptual), geometry_too=not args.frozen)
        triples = data.batches(args.data, seed, args.batch, (3,))
        trainer.run(triples, step, seconds=args.seconds)
    else:
        batches, style_step = style_stage(args, scenes, seed)
        trainer.run(batches, style_step, seconds=args.seconds)


def style_stage(
    args: argparse.Namespace, scenes: Iterator[data.Batch], seed: int
) -> tuple[Iterator[StyleBatch], StyleStep]:
    """The data and the losses of the stylization stage."""
    # Pictures are kept a quarter larger than their crops, for room to choose.
    side = args.size * 5 // 4
    paintings = PictureBank(training_pictures(args.styles, args.style_sources), side)
    photos = PictureBank(training_pictures(args.photos), side * 3 // 2)
    flat = flat_batches(photos, seed, args.batch, args.size)
    teacher = Teacher(args.teacher, args.threads) if args.teacher else None
    step = StyleStep(load_perceptual(args.perceptual), teacher)
    return style_batches(scenes, flat, paintings, seed), step


if __name__ == "__main__":
    main()
