"""`python -m styl3r_export.curriculum STAGE`: train one stage, from a checkpoint or from new."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch

from styl3r_cli.errors import ExitCode, Styl3rError
from styl3r_export.curriculum import data, stages
from styl3r_export.curriculum.data_readers import (
    DL3DV,
    RE10K,
    PaintingFolder,
    VideoBatch,
    inputs_only,
    joined,
    video_batches,
)
from styl3r_export.curriculum.novel_views import NovelViewStep
from styl3r_export.curriculum.perceptual import load_perceptual
from styl3r_export.curriculum.photometric import PhotometricStep
from styl3r_export.curriculum.pictures import PictureBank, flat_batches, training_pictures
from styl3r_export.curriculum.steadying import SteadyStep
from styl3r_export.curriculum.stylization import StyleStep, Teacher, style_batches
from styl3r_export.curriculum.teachers import initialise_flow, initialise_strokes
from styl3r_export.curriculum.trainer import Schedule, Step, Trainer, load_fitting, load_start
from styl3r_export.curriculum.validation import Validation
from styl3r_export.initialise import initialise_from_mast3r
from styl3r_export.model import ModelConfig, Styl3r, build
from styl3r_export.model.config import CONFIGS

# Added to the seed of the scenes that validate, so that they are drawn by other numbers.
VALIDATION_SEED = 1_000_003

TRAINS = {
    "matches": stages.matches_train,
    "geometry": stages.geometry_trains,
    "novel-views": stages.novel_views_train,
    "photometric": stages.used,
    "style": stages.appearance_trains,
    "steady": stages.drawing_trains,
}
FROZEN = {
    "matches": stages.flow_trains,
    "geometry": stages.decoders_train,
    "novel-views": stages.attributes_train,
}
NEEDS = {
    "matches": (),
    "geometry": (),
    "novel-views": ("perceptual",),
    "photometric": ("perceptual",),
    "style": ("perceptual", "styles", "photos"),
    "steady": ("start", "perceptual", "styles", "photos"),
}
# Stages whose losses need no other network.
OWN_LOSSES = {"matches": stages.matches_step, "geometry": stages.geometry_step}
# Stages that take paintings, and photographs as flat scenes.
PAINTING = ("style", "steady")


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="styl3r_export.curriculum", description=__doc__)
    parser.add_argument("stage", choices=list(TRAINS))
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument(
        "--config",
        choices=list(CONFIGS),
        help="the network's sizes (default: the start's, or mini)",
    )
    parser.add_argument(
        "--start",
        type=Path,
        help="checkpoint, or folder of exported graphs, to start from; what does not fit is new",
    )
    scenes = parser.add_argument_group("scenes: generated ones, or posed videos in chunks")
    scenes.add_argument("--data", type=Path, help="folder of scene shards")
    scenes.add_argument("--re10k", type=Path, help="folder of RealEstate10K's chunks")
    scenes.add_argument("--dl3dv", type=Path, help="folder of DL3DV's chunks")
    scenes.add_argument("--held-out", type=Path, help="the same, for the validation as it trains")
    scenes.add_argument("--views", type=int, nargs="+", default=[2])
    scenes.add_argument("--size", type=int, default=128, help="side of videos and flat scenes")
    teachers = parser.add_argument_group("what was trained elsewhere")
    teachers.add_argument("--flow", type=Path, help="RAFT-small (.npz) for a new network")
    teachers.add_argument("--microast", type=Path, help="MicroAST (.npz) for a new network")
    teachers.add_argument("--mast3r", type=Path, help="MASt3R's checkpoint for a new network")
    teachers.add_argument("--perceptual", type=Path, help="VGG (.npz slim, .pth torchvision)")
    teachers.add_argument("--teacher", type=Path, help="2D stylizer (.onnx) to learn from")
    pictures = parser.add_argument_group("pictures of the style stage")
    pictures.add_argument("--styles", type=Path, help="folder of paintings")
    pictures.add_argument("--style-sources", type=Path, help="CSV naming those in public domain")
    pictures.add_argument("--wikiart", action="store_true", help="read them as they are needed")
    pictures.add_argument("--photos", type=Path, help="folder of photographs")
    parser.add_argument(
        "--frozen",
        action="store_true",
        help="matches: leave the maps that decoders read too; geometry: leave matches as they are; "
        "novel views: depths and cameras too",
    )
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--seconds", type=float, default=math.inf, help="stop after this time")
    parser.add_argument("--validate-every", type=int, default=500, metavar="STEPS")
    parser.add_argument("--batch", type=int, default=16, help="scenes of two views a step")
    parser.add_argument("--learning-rate", type=float, default=3e-4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--device", default="cpu")
    args = parser.parse_args()
    missing = [f"--{name}" for name in NEEDS[args.stage] if getattr(args, name) is None]
    if args.stage == "photometric":
        if not (args.re10k or args.dl3dv):
            missing.append("--re10k or --dl3dv")
    elif args.stage not in PAINTING or not (args.re10k or args.dl3dv):
        missing += ["--data"] * (args.data is None)
    if missing:
        parser.error(f"the {args.stage} stage needs {' and '.join(missing)}")
    if args.frozen and args.stage not in FROZEN:
        parser.error(f"--frozen is for {' and '.join(FROZEN)}")
    for name, value in vars(args).items():
        if isinstance(value, Path) and name != "out" and not value.exists():
            parser.error(f"--{name.replace('_', '-')} {value}: there is no such file or folder")
    return args


def main() -> None:
    """Run the stage; start the same command again to go on."""
    args = parse()
    try:
        train(args)
    except (Styl3rError, FileNotFoundError) as error:
        print(f"Error: {error}", file=sys.stderr)
        sys.exit(getattr(error, "exit_code", ExitCode.INPUT))


def train(args: argparse.Namespace) -> None:
    """Run the stage that a command line asks for.

    Raises:
        Styl3rError, FileNotFoundError: what it starts from or learns from is not there.
    """
    torch.manual_seed(args.seed)
    # Optimiser states decay to denormal numbers, on which CPUs are up to ten times slower.
    torch.set_flush_denormal(True)
    torch.set_num_threads(args.threads)
    schedule = Schedule(
        args.steps, learning_rate=args.learning_rate, validate_every=args.validate_every
    )
    trains = (FROZEN if args.frozen else TRAINS)[args.stage]
    trainer = Trainer(
        args.out, schedule, trains, start=args.start, config=args.config, device=args.device
    )
    if trainer.step == 0 and not args.start:
        initialise(trainer, args)
    step = make_step(args)
    # A resumed run does not repeat its first batches.
    batches = make_batches(args, args.seed + trainer.step, trainer.step)
    validation = None
    if args.held_out:
        kept = argparse.Namespace(**vars(args) | held_out(args))
        validation = Validation(make_batches(kept, args.seed + VALIDATION_SEED, 0), step)
    trainer.run(batches, step, seconds=args.seconds, validation=validation)


def initialise(trainer: Trainer, args: argparse.Namespace) -> None:
    """Give a new network what was trained elsewhere."""
    if args.flow:
        initialise_flow(trainer.model, args.flow)
    if args.microast:
        initialise_strokes(trainer.model, args.microast)
    if args.mast3r:
        print(initialise_from_mast3r(trainer.model, args.mast3r).summary())


def held_out(args: argparse.Namespace) -> dict[str, Any]:
    """The sources of scenes with the held-out folder in the place of the one trained on."""
    sources = ("data", "re10k", "dl3dv")
    first = next(name for name in sources if getattr(args, name))
    return {name: args.held_out if name == first else None for name in sources}


def make_step(args: argparse.Namespace) -> Step:
    """The stage's losses."""
    if args.stage in OWN_LOSSES:
        return OWN_LOSSES[args.stage]
    perceptual = load_perceptual(args.perceptual)
    if args.stage == "steady":
        return SteadyStep(start_of(args.start).strokes, args.seed, perceptual)
    if args.stage == "novel-views":
        return NovelViewStep(perceptual, geometry_too=not args.frozen, seed=args.seed)
    if args.stage == "photometric":
        return PhotometricStep(perceptual, args.seed)
    return StyleStep(perceptual, Teacher(args.teacher, args.threads) if args.teacher else None)


def start_of(source: Path) -> Styl3r:
    """The network that training starts from, once more."""
    state = load_start(source)
    model = build(ModelConfig.from_dict(state["config"]))
    load_fitting(model, state["model"])
    return model


def make_batches(args: argparse.Namespace, seed: int, first_step: int) -> Iterator[Any]:
    """What the stage trains on."""
    if args.stage == "photometric":
        return video_scenes(args, seed, first_step)
    # Not ahead in a thread: batches take a hundredth of a step, and torch's threads of two
    # callers wait for each other, which made steps a third slower.
    if args.stage not in PAINTING:
        views = (3,) if args.stage == "novel-views" else tuple(args.views)
        return data.batches(args.data, seed, args.batch, views)
    if args.data:
        scenes = data.batches(args.data, seed, args.batch, tuple(args.views))
    else:
        scenes = inputs_only(video_scenes(args, seed, first_step))
    # Pictures are kept a quarter larger than their crops, for room to choose.
    side = args.size * 5 // 4
    paintings = (
        PaintingFolder(args.styles)
        if args.wikiart
        else PictureBank(training_pictures(args.styles, args.style_sources), side)
    )
    photos = PictureBank(training_pictures(args.photos), side * 3 // 2)
    flat = flat_batches(photos, seed, args.batch, args.size)
    if args.stage == "steady":
        return style_batches(scenes, flat, paintings, seed, identity=0, mixed=0)
    return style_batches(scenes, flat, paintings, seed)


def video_scenes(args: argparse.Namespace, seed: int, first_step: int) -> Iterator[VideoBatch]:
    """Posed videos; with both data sets, half of each batch from either."""
    folders = [(args.re10k, RE10K), (args.dl3dv, DL3DV)]
    given = [(folder, kind) for folder, kind in folders if folder is not None]
    size = max(1, args.batch // len(given))
    each = [
        video_batches(
            folder, kind, seed + number, size,
            inputs=max(args.views), side=args.size, first_step=first_step,
        )
        for number, (folder, kind) in enumerate(given)
    ]  # fmt: skip
    return joined(*each) if len(each) > 1 else each[0]


if __name__ == "__main__":
    main()
