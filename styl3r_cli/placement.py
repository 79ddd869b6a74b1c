"""Views that the network misplaced, put where features that match say they are.

The network finds its matches between 32x32 cells of two views. Where a view turned far, or its
surroundings repeat, all of them can be wrong: then the view's points and camera land anywhere, or
it is given up and made invisible, though the view by itself is as good as others. SIFT's features
are sparse and know nothing of surfaces, but where many of them fit one motion, there is hardly
another explanation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from styl3r_cli.cameras.agreement import Pair, compare, explained
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.matches import Matches
from styl3r_cli.cameras.pnp import find_pose
from styl3r_cli.cameras.pointmap import inlier_ratio
from styl3r_cli.cameras.pose_errors import motion
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.cameras.similarity import moved_camera, size_and_step
from styl3r_cli.cameras.two_view import rays
from styl3r_cli.meetings import depths_at
from styl3r_cli.moved_views import copied, move_view, show_again
from styl3r_cli.pipeline import Scene
from styl3r_cli.view_doubts import doubts

Array = NDArray[np.float64]

# Views are moved if, over all of their matches with those that stay, so many more are explained.
WORTH_MOVING = 1.3


def placed(
    scene: Scene, recovered: Recovered, matches: Sequence[Matches]
) -> tuple[Scene, Recovered]:
    """The scene and its cameras, with views moved whose features contradict their place.

    Views that agree with each other stay together, the first view's stay where they are. The
    distance and the size of what is moved are those at which its points lie where the others' do.
    A view that the network gave up is visible again beyond what the others show, if its place is
    known now. Photos of which few features match are left as they are. Same input, same result.

    Args:
        scene: from `Stylizer.encode`.
        recovered: its cameras.
        matches: of its views.
    """
    cameras = [_own_camera(scene, recovered, view) for view in range(len(scene.images))]
    mover = _Mover(scene, cameras, [compare(each, cameras) for each in matches])
    mover.move_all()
    return mover.result(recovered)


def _own_camera(scene: Scene, recovered: Recovered, view: int) -> Camera:
    """A view's camera as its points have it, also if they are invisible."""
    camera = recovered.cameras[view]
    if recovered.recovered[view]:
        return camera
    pose = find_pose(scene.means[view], np.ones_like(scene.opacities[view]), camera)
    return camera if pose is None else replace(camera, extrinsics=pose)


class _Mover:
    """Groups of views that agree with each other, moved as wholes."""

    def __init__(self, scene: Scene, cameras: list[Camera], pairs: list[Pair]) -> None:
        self.scene, self.cameras, self.pairs = scene, cameras, pairs
        self.moves: dict[int, Array] = {}  # of views, similarities of the world
        self.notes: dict[int, str] = {}  # of the first of them that were moved together
        said = [pair for pair in pairs if pair.confirmed or pair.motion is not None]
        self.matched = {view for pair in said for view in (pair.first, pair.second)}
        self.groups = _groups(len(cameras), pairs, self.matched)
        self.sure = self.groups.pop(0)  # views that are where they belong

    def move_all(self) -> None:
        """Bring one group after the other to the first view's, those that are surest first."""
        while self.groups:
            links = [
                (int(pair.explained.sum()), -number, pair, group)
                for number, pair in enumerate(self.pairs)
                for group in self.groups
                if pair.motion is not None and _links(pair, self.sure, group)
            ]
            if not links:
                break
            *_, pair, group = max(links)
            self.groups.remove(group)
            if self._move(pair, group):
                self.sure |= group

    def _move(self, pair: Pair, group: set[int]) -> bool:
        """Move a group to where a pair's motion has it, if its other matches agree to that."""
        change = self._change(pair)
        if change is None:
            return False
        before = self._explained(self.cameras, group)
        cameras = [
            moved_camera(camera, change) if view in group else camera
            for view, camera in enumerate(self.cameras)
        ]
        after = self._explained(cameras, group)
        if after < WORTH_MOVING * before:
            return False
        self.cameras = cameras
        self.moves |= dict.fromkeys(group, change)
        first, *others = sorted(group)
        along = f" with views {', '.join(str(view + 1) for view in others)}" if others else ""
        self.notes[first] = (
            f"placed{along} by features that match: {after} of them fit, {before} did where the "
            "network had it"
        )
        return True

    def _explained(self, cameras: list[Camera], group: set[int]) -> int:
        """How many matches between a group and the sure views their cameras explain."""
        total = 0
        for pair in self.pairs:
            if _links(pair, self.sure, group):
                one, two = cameras[pair.first], cameras[pair.second]
                move = motion(one.extrinsics, two.extrinsics)
                total += int(explained(move, pair.pixels, one, two).sum())
        return total

    def _change(self, pair: Pair) -> Array | None:
        """(4, 4) similarity of the world that takes the pair's view to where its motion has it."""
        assert pair.motion is not None
        (still, other), (uv, uv_other) = (pair.first, pair.second), pair.pixels
        move: Array = pair.motion
        if still not in self.sure:
            still, other, uv, uv_other = other, still, uv_other, uv
            move = np.linalg.inv(move).astype(np.float64)
        stays, goes, fit = self.cameras[still], self.cameras[other], pair.explained
        here = self._seen_at(still, uv[fit]) @ move[:3, :3].T
        there = self._seen_at(other, uv_other[fit])
        found = size_and_step(here, there, move[:3, 3])
        if found is None:
            return None
        size, step = found
        target = move.copy()
        target[:3, 3] *= step
        grown = np.diag([size, size, size, 1.0])
        return np.linalg.inv(target @ stays.extrinsics) @ grown @ goes.extrinsics

    def _seen_at(self, view: int, pixels: Array) -> Array:
        """(M, 3) places that a view has at pixels, in its camera's frame."""
        camera = self.cameras[view]
        to_camera = camera.extrinsics @ self.moves.get(view, np.eye(4))
        depths = depths_at(self.scene.means[view], to_camera, pixels)
        return rays(pixels, camera.intrinsics) * depths[:, None]

    def result(self, recovered: Recovered) -> tuple[Scene, Recovered]:
        """The scene and its cameras after all moves."""
        scene, sure = copied(self.scene), sorted(self.sure & self.matched)
        cameras, found = list(recovered.cameras), list(recovered.recovered)
        ratios, notes = list(recovered.inlier_ratios), dict(recovered.view_notes)
        for view in sure:
            cameras[view], found[view] = self.cameras[view], True
            if view in self.moves:
                move_view(scene, view, self.moves[view])
        again = show_again(scene, cameras, sure)
        for view in sure:
            ratios[view] = inlier_ratio(scene.means[view], scene.opacities[view], cameras[view])
            told = [self.notes[view]] if view in self.notes else []
            told += ["shown beyond what the others show"] if view in again else []
            if told:
                notes[view] = f"view {view + 1}: {'; '.join(told)}"
            elif not recovered.recovered[view]:
                notes.pop(view, None)
        notes = doubts(scene.opacities, self.matched) | notes
        return scene, Recovered(
            cameras, ratios, found, recovered.focal, recovered.focal_given,
            recovered.focal_notes, notes,
        )  # fmt: skip


def _groups(views: int, pairs: list[Pair], matched: set[int]) -> list[set[int]]:
    """Views that confirmed pairs connect; the first view's group first.

    A view that no pair says anything about stays with the first.
    """
    groups: list[set[int]] = [{0} | (set(range(views)) - matched)]
    groups += [{view} for view in range(1, views) if view in matched]
    for pair in pairs:
        if pair.confirmed:
            one, two = (next(g for g in groups if v in g) for v in (pair.first, pair.second))
            if one is not two:
                one |= two
                groups.remove(two)
    return sorted(groups, key=min)


def _links(pair: Pair, staying: set[int], group: set[int]) -> bool:
    """Whether one of its views is in either."""
    return (pair.first in staying and pair.second in group) or (
        pair.first in group and pair.second in staying
    )
