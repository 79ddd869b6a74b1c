"""Compaction's promises, measured with the renderer itself."""

from __future__ import annotations

import gc

import numpy as np
import pytest
from layered_scene import STRIPED_UP_TO, joined, views

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.compaction import (
    DROPPED,
    Compactor,
    in_between,
    keep_count,
    keep_decibels,
    witnesses,
)
from styl3r_cli.compaction import attempts as attempting
from styl3r_cli.compaction import survey as surveying
from styl3r_cli.fitting.tracing import Trace, look, look_within
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.splatting import render


def decibels(a: Gaussians, b: Gaussians, camera: Camera) -> float:
    """PSNR over a black and a white background, by the renderer."""
    squares = [
        (render(a, camera, (v, v, v)).colour - render(b, camera, (v, v, v)).colour) ** 2
        for v in (0.0, 1.0)
    ]
    return float(-10 * np.log10(np.mean(squares)))


@pytest.mark.parametrize("target", [25.0, 30.0, 38.0, 45.0])
def test_decibels_are_kept_at_every_camera(
    scene: Gaussians, cameras: list[Camera], target: float
) -> None:
    made = keep_decibels(scene, cameras, target)
    if target <= 30:  # more takes nearly all of so coarse a scene
        assert len(made.gaussians) < 0.6 * len(scene)
    assert made.worst >= target
    for camera, told in zip(cameras, made.decibels, strict=True):
        assert decibels(scene, made.gaussians, camera) == pytest.approx(told, abs=0.1)


def test_fewer_decibels_take_fewer_gaussians(scene: Gaussians, cameras: list[Camera]) -> None:
    counts = [len(keep_decibels(scene, cameras, db).gaussians) for db in (25, 30, 45)]
    assert counts == sorted(counts)
    assert 2 * counts[0] < counts[-1]


@pytest.mark.parametrize("share", [0.02, 0.1, 0.3])
def test_a_budget_is_kept_and_beats_a_random_choice(
    scene: Gaussians, cameras: list[Camera], share: float
) -> None:
    count = int(share * len(scene))
    made = keep_count(scene, cameras, count)
    assert len(made.gaussians) == count
    chosen = np.random.default_rng(0).choice(len(scene), count, replace=False)
    for camera in in_between(views(), (0.25, 0.75)):
        assert decibels(scene, made.gaussians, camera) > 3 + decibels(
            scene, scene.select(chosen), camera
        )


def test_flat_regions_get_fewer_than_detail(scene: Gaussians, cameras: list[Camera]) -> None:
    made = keep_count(scene, cameras, len(scene) // 8)
    heights, edge = made.gaussians.means[:, 1], 0.05
    flat = np.count_nonzero(heights > STRIPED_UP_TO + edge) / (1 - STRIPED_UP_TO - edge)
    striped = np.count_nonzero(heights < STRIPED_UP_TO - edge) / (1 + STRIPED_UP_TO - edge)
    assert striped > 1.4 * flat  # per area


def test_what_nobody_sees_goes_and_changes_nothing(scene: Gaussians, cameras: list[Camera]) -> None:
    behind = Gaussians(
        scene.means + np.float32([0, 0, 1]), scene.scales, scene.rotations,
        scene.opacities, scene.colours,
    )  # fmt: skip
    faint = Gaussians(
        scene.means - np.float32([0, 0, 1]), scene.scales, scene.rotations,
        np.full(len(scene), 0.003), scene.colours,
    )  # fmt: skip
    broken = Gaussians(
        np.full((3, 3), np.nan), np.ones((3, 3)), np.ones((3, 4)), np.ones(3), np.ones((3, 3))
    )
    whole = joined(faint, scene, behind, broken)
    made = keep_count(whole, cameras, len(whole))
    came = np.flatnonzero(made.labels != DROPPED)
    # The middle of the hidden wall cannot be seen past the first; its rim can.
    assert ((came >= len(scene)) & (came < 3 * len(scene))).all()
    assert len(made.gaussians) < 1.2 * len(scene)
    assert made.worst > 60


def test_too_many_decibels_keep_everything(scene: Gaussians, cameras: list[Camera]) -> None:
    made = keep_decibels(scene, cameras, 200.0)
    assert len(made.gaussians) == len(scene)


def test_every_colouring_keeps_the_promise(scene: Gaussians, cameras: list[Camera]) -> None:
    compactor = Compactor(scene, cameras)
    random = np.random.default_rng(0)
    others = {
        "own": scene.colours,
        "darker": 0.5 * scene.colours,
        "other": 1 - 0.8 * scene.colours[:, ::-1],
        "striped across": 0.5 + 0.4 * np.sin(9 * scene.means[:, [1]]) * np.float32([1, 0.5, -1]),
        "noise": random.random(scene.colours.shape),
    }
    for name, colours in others.items():
        coloured = scene.with_colours(colours)
        made = compactor.keep_decibels(coloured.colours, 35.0)
        assert made.worst >= 35, name
        for camera, told in zip(cameras, made.decibels, strict=True):
            measured = decibels(coloured, made.gaussians, camera)
            # Above that, the last bits of 23 decide.
            assert measured == pytest.approx(told, abs=0.2) or min(measured, told) > 60, name


def test_a_colouring_does_not_depend_on_those_before_it(
    scene: Gaussians, cameras: list[Camera]
) -> None:
    other = (1 - 0.8 * scene.colours[:, ::-1]).astype(np.float32)
    used, fresh = Compactor(scene, cameras), Compactor(scene, cameras)
    used.keep_decibels(scene.colours, 30.0)
    one, two = (each.keep_decibels(other, 35.0).gaussians for each in (used, fresh))
    for name in ("means", "scales", "rotations", "opacities", "colours"):
        assert (getattr(one, name) == getattr(two, name)).all()


def test_what_is_known_need_not_be_traced_again(
    scene: Gaussians, cameras: list[Camera], monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[int] = []

    def counted(
        gaussians: Gaussians, cameras: list[Camera], most: int, threads: int | None
    ) -> list[Trace] | int:
        looked.append(len(cameras))
        return look_within(gaussians, cameras, most, threads)

    monkeypatch.setattr(surveying, "look_within", counted)
    known = list(zip(cameras[:2], look(scene, cameras[:2], 1), strict=True))
    shared = surveying.survey(scene, cameras, 1, known)
    alone = surveying.survey(scene, cameras, 1)
    assert looked == [len(cameras) - 2, len(cameras)]
    assert (shared.weights == alone.weights).all()
    assert shared.tree is not None
    assert alone.tree is not None
    assert (shared.tree.order == alone.tree.order).all()


def test_the_same_scene_gives_the_same_gaussians(scene: Gaussians, cameras: list[Camera]) -> None:
    one, two = (keep_decibels(scene, cameras, 28.0, threads) for threads in (1, 3))
    for name in ("means", "scales", "rotations", "opacities", "colours"):
        assert (getattr(one.gaussians, name) == getattr(two.gaussians, name)).all()


def test_a_scene_without_cameras_is_seen_from_around(scene: Gaussians) -> None:
    around = witnesses([], scene)
    assert len(around) > 4
    made = keep_count(scene, around, len(scene) // 3)
    assert 0 < len(made.gaussians) <= len(scene) // 3


def test_what_shows_too_much_is_judged_from_smaller_frames(
    scene: Gaussians, cameras: list[Camera], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = sum(len(each.shares) for each in look(scene, cameras, None))
    monkeypatch.setattr(surveying, "MOST_SHARES", whole // 5)
    known = list(zip(cameras[:1], look(scene, cameras[:1], 1), strict=True))
    made = [Compactor(scene, cameras, threads, known) for threads in (1, 3)]
    for each in made:
        listed = sum(len(trace.shares) for trace in each.known.traces)
        assert whole // 20 < listed <= whole // 5
        assert [camera.width for camera in each.cameras] == [made[0].cameras[0].width] * len(
            cameras
        )
    result = made[0].keep_decibels(scene.colours, 30.0)
    assert result.worst >= 30
    assert result.cameras == made[0].cameras


def test_a_camera_that_sees_nothing_keeps_nothing_amiss(scene: Gaussians) -> None:
    away = views()[0]
    turned = np.diag([-1.0, 1, -1, 1])
    blind = Camera(turned, away.fx, away.fy, away.cx, away.cy, away.width, away.height)
    made = keep_decibels(scene, [blind], 45.0)
    assert len(made.gaussians) <= len(scene)


def test_attempts_that_failed_take_no_memory_for_what_was_seen_of_them(
    scene: Gaussians, cameras: list[Camera], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Traces are most of what a compaction takes: gigabytes of a scene of many faint layers."""
    alive: list[int] = []

    def counted(*arguments: object) -> list[Trace]:
        alive.append(sum(isinstance(each, Trace) for each in gc.get_objects()) // len(cameras))
        return look(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(attempting, "look", counted)
    keep_decibels(scene, cameras, 40.0)
    assert len(alive) > 6  # several failed
    # The survey's, the first attempt's in two colourings, and those of what is changed.
    assert max(alive) <= 5
