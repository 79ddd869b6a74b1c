"""`python -m styl3r_export.curriculum STAGE`: train one stage, from a checkpoint or from new."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import torch

from styl3r_export.curriculum import data, stages
from styl3r_export.curriculum.teachers import initialise_stem
from styl3r_export.curriculum.trainer import Schedule, Trainer


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="styl3r_export.curriculum", description=__doc__)
    parser.add_argument("stage", choices=["geometry"])
    parser.add_argument("--data", type=Path, required=True, help="folder of scene shards")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument("--start", type=Path, help="checkpoint to start from")
    parser.add_argument("--stem", type=Path, help="RAFT-small weights (.npz) for a new stem")
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--seconds", type=float, default=math.inf, help="stop after this time")
    parser.add_argument("--batch", type=int, default=16, help="scenes of two views a step")
    parser.add_argument("--views", type=int, nargs="+", default=[2])
    parser.add_argument("--learning-rate", type=float, default=3e-4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--device", default="cpu")
    return parser.parse_args()


def main() -> None:
    """Run the stage; start the same command again to go on."""
    args = parse()
    torch.manual_seed(args.seed)
    torch.set_num_threads(args.threads)
    trainer = Trainer(
        args.out,
        Schedule(args.steps, learning_rate=args.learning_rate),
        stages.geometry_trains,
        start=args.start,
        device=args.device,
    )
    if args.stem and trainer.step == 0 and not args.start:
        initialise_stem(trainer.model, args.stem)
    batches = data.batches(args.data, args.seed + trainer.step, args.batch, tuple(args.views))
    trainer.run(batches, stages.geometry_step, seconds=args.seconds)


if __name__ == "__main__":
    main()
