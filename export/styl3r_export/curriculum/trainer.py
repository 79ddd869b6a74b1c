"""The loop that every stage shares: optimiser, schedule, checkpoints, log."""

from __future__ import annotations

import csv
import math
import sys
import time
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from styl3r_export.checkpoints import listed, read_own
from styl3r_export.curriculum.layout import channels_last
from styl3r_export.graphs_reading import load_graphs
from styl3r_export.model import ModelConfig, Styl3r, build

# Loss terms by name, already weighted; their sum is minimised.
Step = Callable[[Styl3r, Any], dict[str, Tensor]]


@dataclass(frozen=True)
class Schedule:
    """How long to train and how fast (the published optimiser's shape, spec section 11)."""

    steps: int
    learning_rate: float = 3e-4  # of new parameters
    pretrained_factor: float = 0.3  # what was trained elsewhere moves slower
    warm_up: int = 100
    final_factor: float = 0.05  # the cosine ends at this fraction
    weight_decay: float = 0.05
    betas: tuple[float, float] = (0.9, 0.95)
    clip: float = 1.0  # gradient norm
    average: float = 0.999  # of the moving average of the weights that checkpoints hold
    checkpoint_every: float = 120.0  # seconds
    validate_every: int = 500  # steps

    def factor(self, step: int) -> float:
        """Learning rate at a step, as a fraction of its peak."""
        if step < self.warm_up:
            return (step + 1) / self.warm_up
        done = min(1.0, (step - self.warm_up) / max(1, self.steps - self.warm_up))
        cosine = (1 + math.cos(math.pi * done)) / 2
        return self.final_factor + (1 - self.final_factor) * cosine


class Trainer:
    """One stage's run in a folder; started again, it goes on from its last checkpoint."""

    def __init__(
        self,
        folder: Path,
        schedule: Schedule,
        trainable: Callable[[str], bool],
        *,
        start: Path | None = None,
        config: str | None = None,
        device: str = "cpu",
        pretrained: Callable[[str], bool] = lambda name: name.startswith(
            ("backbone.stem.", "matching.flow.cnet.", "matching.flow.update_block.")
        ),
    ) -> None:
        self.folder = folder
        self.schedule = schedule
        folder.mkdir(parents=True, exist_ok=True)
        self.device = torch.device(device)
        self.step = 0
        resume = folder / "last.pt"
        source = resume if resume.exists() else start
        state = load_start(source) if source else None
        sizes: ModelConfig | str = config or "mini"
        if state and (source == resume or config is None):
            sizes = ModelConfig.from_dict(state["config"])
        self.model = build(sizes).to(self.device)
        if state:
            if source == resume:
                self.model.load_state_dict(state["training"])
            else:
                load_fitting(self.model, state["model"])
        # Convolutions in half precision are up to twice as fast with the channels innermost.
        channels_last(self.model.train())
        for name, parameter in self.model.named_parameters():
            parameter.requires_grad_(trainable(name))
        self.frozen = {
            n: p.detach().clone() for n, p in self.model.named_parameters() if not p.requires_grad
        }
        self.average = {n: p.detach().clone() for n, p in self.model.state_dict().items()}
        self.optimiser = self._optimiser(pretrained)
        if state and source == resume:
            self.average = {n: p.to(self.device) for n, p in state["model"].items()}
            self.optimiser.load_state_dict(state["optimiser"])
            self.step = state["step"]

    def _optimiser(self, pretrained: Callable[[str], bool]) -> torch.optim.AdamW:
        groups: dict[tuple[bool, bool], list[Tensor]] = {}
        for name, parameter in self.model.named_parameters():
            if parameter.requires_grad:
                key = (pretrained(name), parameter.ndim > 1)
                groups.setdefault(key, []).append(parameter)
        s = self.schedule
        return torch.optim.AdamW(
            [
                {
                    "params": parameters,
                    "peak": s.learning_rate * (s.pretrained_factor if old else 1.0),
                    "weight_decay": s.weight_decay if matrix else 0.0,
                }
                for (old, matrix), parameters in groups.items()
            ],
            lr=s.learning_rate,
            betas=s.betas,
        )

    def run(
        self,
        data: Iterator[Any],
        step: Step,
        *,
        seconds: float = math.inf,
        log_every: int = 20,
        validation: Callable[[Styl3r], dict[str, float]] | None = None,
    ) -> None:
        """Train until the schedule or the time ends; checkpoints and log lines on the way.

        With a validation, its numbers of the averaged weights go to `validation.csv`: at the
        start, every so many steps, and at the end.
        """
        if validation and self.step == 0:
            self._validate(validation)
        began = saved = time.monotonic()
        first_step = self.step
        sums: dict[str, tuple[float, int]] = {}  # a batch need not have every term
        while self.step < self.schedule.steps and time.monotonic() - began < seconds:
            for name, value in self._train_step(next(data), step).items():
                seen_sum, seen = sums.get(name, (0.0, 0))
                sums[name] = (seen_sum + value, seen + 1)
            if self.step % log_every == 0:
                pace = (self.step - first_step) / (time.monotonic() - began)
                self._log({n: total / n_seen for n, (total, n_seen) in sums.items()}, pace)
                sums = {}
            if time.monotonic() - saved > self.schedule.checkpoint_every:
                self.save()
                saved = time.monotonic()
            ends = self.step == self.schedule.steps
            if validation and (ends or self.step % self.schedule.validate_every == 0):
                self._validate(validation)
        self.save()

    @torch.no_grad()
    def _validate(self, validation: Callable[[Styl3r], dict[str, float]]) -> None:
        """Measure the averaged weights, then go on with those in training."""
        training = {name: value.clone() for name, value in self.model.state_dict().items()}
        self.model.load_state_dict(self.average)
        with torch.autocast(self.device.type, torch.bfloat16):
            found = validation(self.model)
        self.model.load_state_dict(training)
        told = " ".join(f"{name} {value:.4f}" for name, value in found.items())
        print(f"validation at step {self.step} | {told}", file=sys.stderr, flush=True)
        self._write("validation.csv", found)

    def _train_step(self, batch: Any, step: Step) -> dict[str, float]:
        for group in self.optimiser.param_groups:
            group["lr"] = group["peak"] * self.schedule.factor(self.step)
        # bfloat16 needs no loss scaling, and is several times faster on CPUs and GPUs that
        # have matrix units for it; losses and activations of the heads stay in float32.
        with torch.autocast(self.device.type, torch.bfloat16):
            terms = step(self.model, batch)
        total = torch.stack(list(terms.values())).sum()
        self.optimiser.zero_grad(set_to_none=True)
        total.backward()
        parameters = [p for g in self.optimiser.param_groups for p in g["params"]]
        norm = torch.nn.utils.clip_grad_norm_(parameters, self.schedule.clip)
        if torch.isfinite(norm):
            self.optimiser.step()
            self._update_average()
        self.step += 1
        return {n: float(v.detach()) for n, v in terms.items()} | {"norm": float(norm)}

    @torch.no_grad()
    def _update_average(self) -> None:
        decay = min(self.schedule.average, (self.step + 1) / (self.step + 10))
        values = self.model.state_dict()
        kept = [self.average[name] for name in values]
        torch._foreach_lerp_(kept, list(values.values()), 1 - decay)

    def assert_frozen(self) -> None:
        """Raise if a parameter that must not be trained has moved."""
        for name, parameter in self.model.named_parameters():
            if name in self.frozen and not torch.equal(parameter, self.frozen[name]):
                raise AssertionError(f"{name} moved, though this stage must not train it")

    def save(self) -> None:
        """Write `last.pt`: averaged weights as `model`, and all that resuming needs."""
        self.assert_frozen()
        state = {
            "config": self.model.config.to_dict(),
            "model": self.average,
            "training": self.model.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "step": self.step,
        }
        partial = self.folder / "last.pt.partial"
        torch.save(state, partial)
        partial.replace(self.folder / "last.pt")

    def _log(self, terms: dict[str, float], pace: float) -> None:
        left = (self.schedule.steps - self.step) / max(pace, 1e-9)
        text = " ".join(f"{name} {value:.4f}" for name, value in terms.items())
        where = f"step {self.step}/{self.schedule.steps} {pace:.2f}/s {left / 60:.0f} min left"
        print(
            f"{where} | {text}",
            file=sys.stderr,
            flush=True,
        )
        self._write("log.csv", terms)

    def _write(self, name: str, numbers: dict[str, float]) -> None:
        """Add a line to a table in the run's folder."""
        log = self.folder / name
        new = not log.exists()
        with log.open("a", newline="") as file:
            writer = csv.writer(file)
            if new:
                writer.writerow(["step", *numbers])
            writer.writerow([self.step, *(f"{v:.5f}" for v in numbers.values())])


def load_checkpoint(path: Path) -> dict[str, Any]:
    """A checkpoint of this project, apart from its file: the run that goes on replaces that.

    Raises:
        InputError: it is none.
    """
    return deepcopy(dict(read_own(path)))


def load_start(source: Path) -> dict[str, Any]:
    """What training can start from: a checkpoint, or a folder of exported graphs.

    Raises:
        InputError, ModelError: there is neither.
    """
    if not source.is_dir():
        return load_checkpoint(source)
    model, _ = load_graphs(source)
    return {"config": model.config.to_dict(), "model": model.state_dict()}


def load_fitting(model: Styl3r, weights: dict[str, Tensor]) -> None:
    """Load what has the model's name and shape, and say what does not."""
    own = model.state_dict()
    fitting = {n: w for n, w in weights.items() if n in own and own[n].shape == w.shape}
    model.load_state_dict(fitting, strict=False)
    if missing := sorted(set(own) - set(fitting)):
        print(f"starting anew: {listed(missing)}", file=sys.stderr)
