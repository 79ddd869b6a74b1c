"""Checkpoints into models: the published ones, and this project's own."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from styl3r_cli.errors import InputError, shortened
from styl3r_export.model import FULL, ModelConfig, Styl3r
from styl3r_export.safe_pickle import read_checkpoint

# What published (Lightning) checkpoints put before the network's names.
PREFIX = "encoder."
# Names listed in a message before the rest is counted.
LISTED = 6


class CheckpointError(InputError):
    """A checkpoint does not hold the network; `report` lists every name."""

    def __init__(self, message: str, report: LoadReport) -> None:
        super().__init__(message)
        self.report = report


@dataclass
class LoadReport:
    """What became of a checkpoint's entries.

    Attributes:
        loaded: the model's entries that were set.
        missing: the model's entries that the checkpoint does not have.
        unexpected: the checkpoint's entries that the model does not have.
        reshaped: entries whose shapes differ, with both shapes.
        unusable: the model's entries that are sparse, quantised, complex or integer in the file.
        dropped: the checkpoint's entries outside of the network (no `encoder.` prefix).
        differing_aliases: names of tensors that came twice with different values.
    """

    loaded: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    unexpected: list[str] = field(default_factory=list)
    reshaped: list[str] = field(default_factory=list)
    unusable: list[str] = field(default_factory=list)
    dropped: list[str] = field(default_factory=list)
    differing_aliases: list[str] = field(default_factory=list)

    @property
    def complete(self) -> bool:
        """Whether checkpoint and model have the same entries and shapes."""
        return not (self.missing or self.unexpected or self.reshaped or self.unusable)

    def summary(self) -> str:
        """One line: what differs, the first names of each kind."""
        kinds = {
            "missing": self.missing,
            "unexpected": self.unexpected,
            "of another shape": self.reshaped,
            "no floating-point numbers": self.unusable,
        }
        return "; ".join(f"{len(n)} {kind}: {listed(n)}" for kind, n in kinds.items() if n)


def listed(names: Iterable[str]) -> str:
    """The first few names, and how many more there are."""
    names = [shortened(name) for name in names]
    rest = len(names) - LISTED
    return ", ".join(names[:LISTED]) + (f" and {rest} more" if rest > 0 else "")


def canonical(name: str) -> str:
    """The name that wins where a tensor has two: `layer_rn.0`, not `layer1_rn`.

    Published checkpoints list four convolutions of every dense head twice, and the published
    loader sets `layer_rn.*` last.
    """
    return re.sub(
        r"\.scratch\.layer([1-4])_rn\.",
        lambda match: f".scratch.layer_rn.{int(match[1]) - 1}.",
        name,
    )


def empty_model(config: ModelConfig) -> Styl3r:
    """A model without memory for its weights, to be given a checkpoint's."""
    with torch.device("meta"):
        return Styl3r(config).eval()


def load_published(path: Path) -> tuple[Styl3r, LoadReport]:
    """A published checkpoint as the network `full`.

    Args:
        path: a Lightning file: weights under `state_dict`, names prefixed with `encoder.`.

    Returns:
        The model (eval mode, float32, CPU), and what else the file held.

    Raises:
        InputError: the file is no such checkpoint.
        CheckpointError: entries are missing, unexpected, or have other shapes.
    """
    return _published(path, read_checkpoint(path))


def _published(path: Path, content: object) -> tuple[Styl3r, LoadReport]:
    entries = content.get("state_dict") if isinstance(content, Mapping) else None
    if not isinstance(entries, Mapping):
        raise InputError(f"{path}: has no 'state_dict'; name a published Styl3R checkpoint")
    return _load_strictly(path, empty_model(FULL), entries)


def _load_strictly(
    path: Path, model: Styl3r, entries: Mapping[str, Any]
) -> tuple[Styl3r, LoadReport]:
    """Give a model without memory the entries that carry the prefix, all or none."""
    named = {str(n).removeprefix(PREFIX): v for n, v in entries.items() if is_network(n)}
    report = compare(model, named)
    report.dropped = sorted(str(n) for n in entries if not is_network(n))
    if not report.complete:
        message = f"{path}: not the weights of {model.config.name}: {report.summary()}"
        raise CheckpointError(message, report)
    report.differing_aliases = differing_aliases(named)
    # Training leaves convolutions with their channels innermost, which tracing does not expect.
    state = {n: named[canonical(n)].float().contiguous() for n in model.state_dict()}
    model.load_state_dict(state, strict=True, assign=True)
    report.loaded = sorted(state)
    return model, report


def is_network(name: object) -> bool:
    """Whether a published checkpoint's entry belongs to the network."""
    return str(name).startswith(PREFIX)


def compare(model: Styl3r, entries: Mapping[str, Any]) -> LoadReport:
    """What a strict load of these entries would complain about."""
    wanted = model.state_dict()
    report = LoadReport(
        missing=sorted(wanted.keys() - entries.keys()),
        unexpected=sorted(
            n for n, v in entries.items() if n not in wanted or not isinstance(v, Tensor)
        ),
    )
    for name in sorted((wanted.keys() & entries.keys()) - set(report.unexpected)):
        if not is_plain(entries[name]):
            report.unusable.append(name)
            continue
        ours, theirs = tuple(wanted[name].shape), tuple(entries[name].shape)
        if ours != theirs:
            report.reshaped.append(f"{name} {theirs} instead of {ours}")
    return report


def is_plain(value: Tensor) -> bool:
    """Whether a tensor is an ordinary array of floating-point numbers, and in memory."""
    ordinary = value.layout == torch.strided and not (value.is_nested or value.is_meta)
    return ordinary and value.is_floating_point()  # quantised, complex: not


def differing_aliases(entries: Mapping[str, Tensor]) -> list[str]:
    """Names that lose to their alias, because the two hold different values."""
    twice = [n for n in entries if canonical(n) != n and canonical(n) in entries]
    return sorted(n for n in twice if not torch.equal(entries[n], entries[canonical(n)]))


def load_own(path: Path) -> Styl3r:
    """A checkpoint that this project's training wrote: `config` and `model`.

    Raises:
        InputError: the file is no such checkpoint.
        CheckpointError: the weights do not belong to the configuration.
    """
    return _own(path, read_own(path))


def read_own(path: Path) -> Mapping[str, Any]:
    """The contents of a checkpoint that this project's training wrote.

    Raises:
        InputError: the file is no such checkpoint.
    """
    content = read_checkpoint(path)
    if not is_own(content):
        raise InputError(f"{path}: has no 'config' and 'model'; name a training run's checkpoint")
    return content


def _own(path: Path, content: Mapping[str, Any]) -> Styl3r:
    try:
        model = empty_model(ModelConfig.from_dict(dict(content["config"])))
    except Exception as error:  # sizes that do not belong together fail anywhere in torch
        message = f"{path}: {shortened(str(error))}; it is damaged, or of another version"
        raise InputError(message) from error
    entries = {f"{PREFIX}{n}": v for n, v in content["model"].items()}
    return _load_strictly(path, model, entries)[0]


def is_own(content: object) -> bool:
    """Whether a checkpoint's contents are this project's."""
    if not isinstance(content, Mapping):
        return False
    return all(isinstance(content.get(k), Mapping) for k in ("config", "model"))


def load_any(path: Path) -> Styl3r:
    """A published checkpoint or one of this project's, whichever the file is.

    Raises:
        InputError: it is neither.
        CheckpointError: it is one of them, but not complete.
    """
    content = read_checkpoint(path)
    return _own(path, content) if is_own(content) else _published(path, content)[0]
