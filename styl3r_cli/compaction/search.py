"""How many Gaussians a promise takes: so many decibels, or so many at most."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.compaction import counts
from styl3r_cli.compaction.attempts import Attempt, Merged, attempt, merge_cut, reshaped
from styl3r_cli.compaction.compaction import DROPPED, Compaction, decibels, everything
from styl3r_cli.compaction.cuts import Splits
from styl3r_cli.compaction.survey import survey
from styl3r_cli.compaction.tree import Tree
from styl3r_cli.fitting.refit import Target, squared_errors
from styl3r_cli.fitting.tracing import Trace, look
from styl3r_cli.gaussians import FloatArray, Gaussians

# Steps of the colours' least squares: a fourth and fifth gain 0.3 dB together. One, where only the
# errors' places are wanted.
REFIT_STEPS, ROUGH_STEPS = 3, 1
# A cut is found by way of a coarser one, whose measured errors say where to split: that is worth
# 3 dB. The way to a budget begins with that share of it, the way to a promise with what the tree
# foretells for so many decibels less: the tree sees errors twice to four times as large as they
# are. What follows aims so much above the promise that two attempts do for most scenes: with a
# third there are 1.6 % fewer Gaussians, and it takes a third longer (19 scenes, 45 dB).
BEGIN_SHARE, BEGIN_BELOW, AIM_ABOVE = 0.6, 4.0, 0.5
# Shapes are fitted so often; that gains so many decibels, at least. It takes as long again.
RESHAPES, RESHAPED = 2, 4.0
WASTE = 2.0  # decibels too many are worth one more attempt
# Shares that are no longer worth an attempt: of what is known to do, and, where nothing else is, of
# the whole scene: there is more to wait for than to gain where hardly anything may be merged.
FINE, HARDLY_LESS = 0.97, 0.9
MOST_ATTEMPTS = 8
# What is brighter, or darker than minus that, is merged as if it were that: no display shows the
# difference, and squares of it, summed over pixels, are within float32.
BRIGHTEST = 1e4


class Compactor:
    """A scene, looked at once, and compacted as often as it gets other colours.

    Geometry is sorted by the colours that it comes with; which of it is merged is decided for each
    colouring on its own, from errors measured in it, so that each has what it was promised.

    Example:
        >>> compactor = Compactor(scene, witnesses(views, scene))
        >>> small = compactor.keep_decibels(scene.colours, 45.0)
    """

    def __init__(
        self,
        scene: Gaussians,
        cameras: Sequence[Camera],
        threads: int | None = None,
        traced: Sequence[tuple[Camera, Trace]] = (),
        reshapes: int = RESHAPES,
    ) -> None:
        """Survey the scene.

        Args:
            scene: the G Gaussians.
            cameras: the witnesses.
            threads: None for every core.
            traced: what some of the witnesses see of the scene, if that is known.
            reshapes: how often shapes are fitted; half the time and a third more Gaussians at 0.
        """
        self.threads, self.reshapes = threads, reshapes
        scene = scene.with_colours(within_float32(scene.colours))
        self.known = survey(scene, cameras, threads, traced)
        self._begun: tuple[int, Merged] | None = None

    @property
    def cameras(self) -> list[Camera]:
        """The witnesses, with smaller frames than asked for if those showed too much."""
        return self.known.cameras

    def keep_decibels(self, colours: FloatArray, target: float) -> Compaction:
        """As few Gaussians as keep every witness's frame within `target` decibels (PSNR).

        Measured: each attempt is drawn. The first is coarse on purpose, the others refine it.

        Args:
            colours: (G, 3) sRGB.
            target: PSNR against the whole scene, at the witness that differs most.
        """
        known, colours = self.known, within_float32(colours)
        whole = known.scene.with_colours(colours)
        if known.tree is None:  # no witness sees any of it
            return everything(whole, known.cameras)
        targets, shown = known.targets(colours), self._shown(colours)
        most = len(known.seen)
        gain = RESHAPED if self.reshapes else 0.0
        count = counts.foretold(known.tree, targets, target - BEGIN_BELOW - gain)
        failed: list[Attempt] = []
        done: Attempt | None = None
        rough: Attempt | None = None
        for _ in range(MOST_ATTEMPTS):
            if count >= (HARDLY_LESS * most if done is None else FINE * len(done.gaussians)):
                break
            if rough is None:
                made = rough = self._attempt(count, None, shown, targets, ROUGH_STEPS)
            else:
                above = failed[-1] if failed else rough
                # Nothing here holds on to what was seen before the shapes were fitted.
                made = self._reshaped(
                    self._attempt(count, above, shown, targets, REFIT_STEPS), targets, target
                )
            if made.worst >= target:
                done = made
                if made.worst - target < WASTE:
                    break
            elif made is not rough:
                failed.append(made)
            if done is None and not failed:
                count = counts.more(known.tree, rough, target + AIM_ABOVE - gain)
            else:
                count = counts.better(failed, done, target)
        if done is not None:
            return self._result(done)
        result = self.without_unseen(colours)
        return result if result.worst >= target else everything(whole, known.cameras)

    def keep_count(self, colours: FloatArray, count: int) -> Compaction:
        """At most `count` Gaussians, so that the witnesses see as little difference as possible.

        Args:
            colours: (G, 3) sRGB.
            count: at least 1.
        """
        colours = within_float32(colours)
        if count >= len(self.known.seen):
            return self.without_unseen(colours)
        targets, shown = self.known.targets(colours), self._shown(colours)
        first = max(1, round(BEGIN_SHARE * count))
        rough = self._attempt(first, None, shown, targets, ROUGH_STEPS)
        made = self._reshaped(
            self._attempt(count, rough, shown, targets, REFIT_STEPS), targets, math.inf
        )
        return self._result(made)

    def without_unseen(self, colours: FloatArray) -> Compaction:
        """Only what no witness sees is left out, and the rest is as it was."""
        known = self.known
        labels = np.full(len(known.scene), DROPPED, np.int64)
        labels[known.seen] = np.arange(len(known.seen))
        left = known.gaussians.with_colours(colours[known.seen])
        targets = known.targets(colours)
        return Compaction(
            left, labels, known.cameras, _decibels(targets, left, known.cameras, self.threads)
        )

    def _shown(self, colours: FloatArray) -> FloatArray:
        """Colours of what is seen; the very ones of the survey, if they are the scene's."""
        known = self.known
        own = colours is known.scene.colours
        return known.gaussians.colours if own else colours[known.seen]

    def _attempt(
        self,
        count: int,
        above: Attempt | None,
        colours: FloatArray,
        targets: Sequence[Target],
        steps: int,
    ) -> Attempt:
        tree = self.known.tree
        assert tree is not None
        if above is None:
            merged = self._first(tree, count)
        else:
            merged = merge_cut(self.known, above.splits(tree).cut(count), self.threads)
        return attempt(self.known, merged, colours, targets, steps, self.threads)

    def _reshaped(self, made: Attempt, targets: Sequence[Target], enough: float) -> Attempt:
        """The attempt with its shapes fitted, until that is good enough or no longer helps.

        What the witnesses see of it is let go of: it takes more memory than all the rest.
        """
        for _ in range(self.reshapes):
            if made.worst >= enough:
                break
            better = reshaped(self.known, made, targets, self.threads)
            if better.worst <= made.worst:
                break
            made = better
        return replace(made, traces=[])

    def _first(self, tree: Tree, count: int) -> Merged:
        """A cut as the tree has it: all colours begin with the same one."""
        if self._begun is None or self._begun[0] != count:
            merged = merge_cut(self.known, Splits.of(tree).cut(count), self.threads)
            self._begun = count, merged
        return self._begun[1]

    def _result(self, made: Attempt) -> Compaction:
        labels = np.full(len(self.known.scene), DROPPED, np.int64)
        labels[self.known.seen] = made.cut.labels
        return Compaction(made.gaussians, labels, self.known.cameras, made.decibels)


def within_float32(colours: FloatArray) -> FloatArray:
    """The colours, or if any is beyond BRIGHTEST, all within it."""
    if np.abs(colours).max(initial=0) <= BRIGHTEST:
        return colours
    return np.clip(colours, -BRIGHTEST, BRIGHTEST)


def keep_count(
    scene: Gaussians, cameras: Sequence[Camera], count: int, threads: int | None = None
) -> Compaction:
    """At most `count` of a scene's Gaussians; see `Compactor.keep_count`."""
    return Compactor(scene, cameras, threads).keep_count(scene.colours, count)


def keep_decibels(
    scene: Gaussians, cameras: Sequence[Camera], target: float, threads: int | None = None
) -> Compaction:
    """As few Gaussians as keep `target` decibels; see `Compactor.keep_decibels`."""
    return Compactor(scene, cameras, threads).keep_decibels(scene.colours, target)


def measured(
    whole: Gaussians, other: Gaussians, cameras: Sequence[Camera], threads: int | None = None
) -> list[float]:
    """PSNR of a scene against the whole one at each witness, as compactions are measured."""
    targets = [Target.of(each) for each in look(whole, cameras, threads)]
    return _decibels(targets, other, cameras, threads)


def _decibels(
    targets: Sequence[Target], scene: Gaussians, cameras: Sequence[Camera], threads: int | None
) -> list[float]:
    traces = look(scene, cameras, threads)
    pairs = zip(targets, traces, strict=True)
    return decibels([squared_errors(target, each.picture, each.through) for target, each in pairs])
