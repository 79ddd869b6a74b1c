"""Start a training from other networks' checkpoints: MASt3R's and NoPoSplat's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from styl3r_cli.errors import InputError
from styl3r_export.checkpoints import PREFIX, canonical, listed
from styl3r_export.model import Styl3r
from styl3r_export.safe_pickle import read_checkpoint

# MASt3R's parts that also start the style encoder and the stylization decoder.
STYLIZER_PARTS = ("enc", "patch_embed", "mask_token", "dec")
# A dense head's last convolution: other networks' have more output channels after ours (a
# confidence, colours of higher degree).
LAST_CONVOLUTION = ".dpt.head.4."


@dataclass(frozen=True)
class InitialisationReport:
    """What an initialisation did.

    Attributes:
        loaded: the model's entries that were set.
        untouched: the model's entries that kept their values.
        ignored: the checkpoint's entries that fitted nowhere.
    """

    loaded: list[str]
    untouched: list[str]
    ignored: list[str]

    def summary(self) -> str:
        """One line with counts, and the modules or entries concerned."""
        modules = sorted({n.split(".")[0] for n in self.untouched})
        return (
            f"{len(self.loaded)} entries loaded; {len(self.untouched)} untouched"
            f" (in {', '.join(modules) or 'no module'}); {len(self.ignored)} of the checkpoint"
            f" ignored ({listed(self.ignored) or 'none'})"
        )


def initialise_from_mast3r(model: Styl3r, path: Path) -> InitialisationReport:
    """Set what MASt3R's checkpoint holds (spec section 10), in place.

    The transformers go to the backbone and, but for the second decoder, also to the stylizer;
    the point heads are taken without the channel of their confidence.

    Raises:
        InputError: the file is no such checkpoint, or nothing in it fits.
    """

    def targets(name: str) -> list[str]:
        if name.startswith("downstream_head"):
            return [name]
        if "downstream_head" in name:
            return []
        also = [f"token_stylizer.{name}"] if name.startswith(STYLIZER_PARTS) else []
        return [f"backbone.{name}", *also]

    return _initialise(model, path, _entries(path, "model"), targets)


def initialise_from_noposplat(model: Styl3r, path: Path) -> InitialisationReport:
    """Set what a NoPoSplat checkpoint holds, in place: its backbone and heads have our names.

    Raises:
        InputError: the file is no such checkpoint, or nothing in it fits.
    """

    def targets(name: str) -> list[str]:
        return [name.removeprefix(PREFIX)] if name.startswith(PREFIX) else []

    return _initialise(model, path, _entries(path, "state_dict"), targets)


def _entries(path: Path, key: str) -> Mapping[str, Tensor]:
    content = read_checkpoint(path)
    entries = content.get(key) if isinstance(content, Mapping) else None
    if not isinstance(entries, Mapping):
        raise InputError(f"{path}: has no '{key}'; name a checkpoint of the network it is read as")
    return {str(n): v for n, v in entries.items() if isinstance(v, Tensor)}


@torch.no_grad()
def _initialise(
    model: Styl3r,
    path: Path,
    entries: Mapping[str, Tensor],
    targets: Callable[[str], list[str]],
) -> InitialisationReport:
    ours = model.state_dict()
    sources: dict[str, Tensor] = {}
    ignored = []
    for name in sorted(entries):  # `layer1_rn` before `layer_rn`, which wins
        fitting = {
            canonical(target): fitted
            for target in targets(name)
            if target in ours and (fitted := _fit(target, entries[name], ours[target])) is not None
        }
        sources |= fitting
        if not fitting:
            ignored.append(name)
    if not sources:
        raise InputError(f"{path}: nothing in it fits the network '{model.config.name}'")
    for name, value in sources.items():
        ours[name].copy_(value)
    loaded = [n for n in ours if canonical(n) in sources]
    return InitialisationReport(loaded, [n for n in ours if canonical(n) not in sources], ignored)


def _fit(name: str, theirs: Tensor, ours: Tensor) -> Tensor | None:
    """Their values where the shapes agree, cut to our channels in a head's last convolution."""
    if LAST_CONVOLUTION in name and theirs.shape[1:] == ours.shape[1:]:
        theirs = theirs[: len(ours)]
    return theirs if theirs.shape == ours.shape else None
