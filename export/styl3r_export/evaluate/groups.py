"""Which photos of a scene are given to the network together: neighbours that share points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

from styl3r_cli.photos.load import spread
from styl3r_export.evaluate.scenes import TrueScene, TrueView

T = TypeVar("T")

# Consecutive inputs share at least this part of the points of the one that has fewer, and at
# least this many: below it, people would not call them photos of the same thing.
LEAST_SHARED = 0.25
FEWEST_SHARED = 40
# A photo between the inputs is asked for only if the inputs saw this part of its points: what
# nobody saw, nobody can draw.
LEAST_COVERED = 0.5
LONGEST_STEP = 3  # photos from one input to the next


@dataclass(frozen=True)
class Group:
    """Photos of one scene given together, and others to be drawn.

    Attributes:
        scene: where they are from.
        inputs: indices of the scene's photos.
        targets: indices of photos between them; none where there is no suitable one.
    """

    scene: TrueScene
    inputs: tuple[int, ...]
    targets: tuple[int, ...] = ()

    @property
    def views(self) -> list[TrueView]:
        """The photos that are given."""
        return [self.scene.views[index] for index in self.inputs]


def choose_groups(scene: TrueScene, views: int, most: int) -> list[Group]:
    """Up to `most` groups, spread evenly over the scene: the same ones for every model.

    Half of them, where there are as many, have a photo to be drawn between the inputs; the others
    are neighbours without a gap.

    Args:
        scene: the photos in order.
        views: inputs of a group.
        most: groups at most.
    """
    gapped: list[Group] = []
    adjacent: list[Group] = []
    for inputs in _candidates(len(scene.views), views):
        given = [scene.views[index] for index in inputs]
        if all(_overlap(a, b) for a, b in pairwise(given)):
            target = _target(scene, inputs)
            if target is None:
                adjacent.append(Group(scene, inputs))
            else:
                gapped.append(Group(scene, inputs, (target,)))
    without = min(len(adjacent), max(most // 2, most - len(gapped)))
    chosen = pick(gapped, most - without) + pick(adjacent, without)
    return sorted(chosen, key=lambda group: group.inputs)


def pick(items: Sequence[T], most: int) -> list[T]:
    """Evenly spaced items, the middle one if only one may be taken."""
    if most <= 1:
        return list(items[len(items) // 2 : len(items) // 2 + most])
    return [items[index] for index in spread(len(items), most)]


def _candidates(count: int, views: int) -> Iterator[tuple[int, ...]]:
    """Index tuples: equal steps, and single steps with a double one in the middle."""
    for first in range(count):
        for step in range(1, LONGEST_STEP + 1):
            even = tuple(first + step * k for k in range(views))
            if even[-1] < count:
                yield even
        half = views // 2
        left_out = (*range(first, first + half), *range(first + half + 1, first + views + 1))
        # With two views that is a pair of double step, which was already there.
        if views > 2 and left_out[-1] < count:
            yield left_out


def _overlap(a: TrueView, b: TrueView) -> bool:
    shared = len(set(a.points.tolist()) & set(b.points.tolist()))
    fewer = min(len(a.points), len(b.points))
    return shared > FEWEST_SHARED and shared >= LEAST_SHARED * fewer


def _target(scene: TrueScene, inputs: tuple[int, ...]) -> int | None:
    """The photo in the middle of the middle gap, if the inputs saw enough of it."""
    before, after = inputs[(len(inputs) - 1) // 2 :][:2]
    if after - before < 2:
        return None
    middle = (before + after) // 2
    seen = {point for index in inputs for point in scene.views[index].points.tolist()}
    points = scene.views[middle].points.tolist()
    covered = sum(point in seen for point in points)
    return middle if points and covered >= LEAST_COVERED * len(points) else None
