"""Views in wrong places go back to where they were taken from; right ones stay."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from wavy_wall import FOCAL, SIDE, match_images, wall

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.pose_errors import direction_error, motion, rotation_error
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.overlaps import Overlaps
from styl3r_cli.pipeline import Scene
from styl3r_cli.placement import placed as placed_by
from styl3r_cli.splatting import render

WRONG = cv2.Rodrigues(np.array([0.3, -0.8, 0.5]))[0]
SIZE, SHIFT = 1.3, np.array([0.4, -0.2, 0.5])


def placed(
    scene: Scene, recovered: Recovered, threads: int | None = None
) -> tuple[Scene, Recovered]:
    return placed_by(scene, recovered, match_images(scene.images, threads))


def misplace(scene: Scene, recovered: Recovered, views: list[int]) -> tuple[Scene, Recovered]:
    """The views, with their cameras, turned, shifted and enlarged together."""
    means, scales, rotations = scene.means.copy(), scene.scales.copy(), scene.rotations.copy()
    cameras = list(recovered.cameras)
    for view in views:
        means[view] = SIZE * means[view] @ WRONG.T + SHIFT
        scales[view] *= SIZE
        rotations[view] = quaternion(WRONG)  # of Gaussians that had none
        extrinsics = cameras[view].extrinsics.copy()
        extrinsics[:3, :3] = extrinsics[:3, :3] @ WRONG.T
        extrinsics[:3, 3] = SIZE * extrinsics[:3, 3] - extrinsics[:3, :3] @ SHIFT
        cameras[view] = replace(cameras[view], extrinsics=extrinsics)
    scene = replace(scene, means=means, scales=scales, rotations=rotations)
    return scene, replace(recovered, cameras=cameras)


def quaternion(turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of a rotation vector's matrix, by its axis and angle."""
    vector = cv2.Rodrigues(turn)[0][:, 0]
    angle = np.linalg.norm(vector)
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * vector / angle])


def errors(found: Recovered, true: Recovered) -> list[float]:
    """Degrees that each camera is off from where it is seen by the first."""
    pairs = [
        [motion(r.cameras[0].extrinsics, r.cameras[view].extrinsics) for r in (found, true)]
        for view in range(1, len(true.cameras))
    ]
    return [max(rotation_error(*pair), direction_error(*pair)) for pair in pairs]


def test_what_is_right_stays_as_it_is() -> None:
    scene, recovered = wall(3)
    made, found = placed(scene, recovered)
    for name in ("means", "scales", "rotations", "opacities"):
        np.testing.assert_array_equal(getattr(made, name), getattr(scene, name))
    for one, other in zip(found.cameras, recovered.cameras, strict=True):
        np.testing.assert_array_equal(one.extrinsics, other.extrinsics)
    assert found.notes == []


@pytest.mark.parametrize("views", [[1], [2], [1, 2], [2, 3]])
def test_misplaced_views_go_back(views: list[int]) -> None:
    scene, recovered = wall(4)
    wrong, there = misplace(scene, recovered, views)
    assert max(errors(there, recovered)) > 30
    made, found = placed(wrong, there)
    assert max(errors(found, recovered)) < 1.5
    for view in range(4):
        off = np.linalg.norm(made.means[view] - scene.means[view], axis=-1)
        assert np.median(off) < 0.02 * 2  # 2 units away
        np.testing.assert_allclose(made.scales[view], scene.scales[view], rtol=0.03)
        straight = np.abs(made.rotations[view] @ np.array([1, 0, 0, 0], np.float32))
        assert straight.min() > np.cos(np.radians(1))
    assert found.recovered == [True] * 4
    (note,) = found.notes
    first, *others = views
    along = "".join(f" with views {view + 1}" for view in others)
    assert note.startswith(f"view {first + 1}: placed{along} by features")


def test_what_was_moved_is_drawn_as_before() -> None:
    """From where its camera went, a moved view's Gaussians look as they did."""
    scene, recovered = wall(2)
    wrong, there = misplace(scene, recovered, [1])
    made, found = placed(wrong, there)
    frames = []
    for one, camera in ((wrong, there.cameras[1]), (made, found.cameras[1])):
        colours = one.images[1].transpose(1, 2, 0).reshape(-1, 3)
        geometry = (one.means, one.scales, one.rotations)
        parts = [each[1].reshape(-1, each.shape[-1]) for each in geometry]
        frames.append(render(Gaussians(*parts, one.opacities[1].ravel(), colours), camera).colour)
    off = np.abs(frames[0] - frames[1])
    # Rounding turns the order of some that are equally far.
    assert off.mean() < 1e-4
    assert off.max() < 0.05


def given_up(scene: Scene, recovered: Recovered, view: int) -> tuple[Scene, Recovered]:
    """The view is invisible, and the camera of the view before it stands in for its own."""
    opacities, cameras, found = scene.opacities.copy(), [*recovered.cameras], [True] * 3
    opacities[view], cameras[view], found[view] = 0, cameras[view - 1], False
    notes = {view: f"view {view + 1}: no camera explains its points"}
    ratios = [1.0 if each else 0.0 for each in found]
    there = Recovered(
        cameras, ratios, found, recovered.focal, recovered.focal_given, ["a lens"], notes
    )
    return replace(scene, opacities=opacities), there


def test_a_view_that_was_given_up_is_shown_beyond_the_others() -> None:
    scene, recovered = wall(3)
    made, found = placed(*given_up(scene, recovered, 2))
    assert found.recovered == [True] * 3
    assert min(found.inlier_ratios) > 0.99
    assert max(errors(found, recovered)) < 0.1
    assert found.notes == ["a lens", "view 3: shown beyond what the others show"]
    u, v, z = np.moveaxis(in_camera(scene.means[2], recovered.cameras[1]), -1, 0)
    inside = (u > 0) & (u < SIDE) & (v > 0) & (v < SIDE) & (z > 0)
    assert 0.5 < inside.mean() < 0.98
    shown = made.opacities[2] > 0.5
    # The first camera sees a little that the second does not.
    assert not (shown & inside).any()
    assert (shown | inside).mean() > 0.95
    np.testing.assert_array_equal(made.opacities[:2], scene.opacities[:2])


def test_a_view_that_shows_nothing_more_is_not_said_to_be_shown() -> None:
    scene, recovered = given_up(*wall(3), 2)
    for each in (scene.images, scene.means):
        each[2] = each[1]
    made, found = placed(scene, recovered)
    assert found.recovered == [True] * 3
    assert not made.opacities[2].any()
    told = "view 3: hardly visible: it fits the others badly, or they show all of it"
    assert found.notes == ["a lens", told]


@pytest.mark.parametrize("stranger", [0, 1, 2])
def test_a_photo_of_another_place_is_named(stranger: int) -> None:
    scene, recovered = wall(3)
    scene.images[stranger] = wall(1, seed=7)[0].images[0]
    _, found = placed(scene, recovered)
    (note,) = found.view_notes.values()
    assert note.startswith(f"view {stranger + 1}: shares hardly any features with the others")
    # Two photos of which neither is like the other: there is no telling which.
    pair = replace(wall(2)[0], images=scene.images[[stranger, stranger - 1]])
    assert placed(pair, wall(2)[1])[1].view_notes == {}


def in_camera(points: NDArray[np.float32], camera: Camera) -> NDArray[np.float64]:
    """(..., 3) pixels and depth."""
    seen = points @ camera.extrinsics[:3, :3].T + camera.extrinsics[:3, 3]
    u, v = (FOCAL * seen[..., axis] / seen[..., 2] + SIDE / 2 for axis in (0, 1))
    return np.stack([u, v, seen[..., 2]], axis=-1)


def test_what_is_invisible_stands_for_nothing() -> None:
    """The middle view, from which others take what they see, too, was given up: nothing is lost."""
    made, found = placed(*given_up(*wall(3), 1))
    kept = Overlaps(made, found).kept & (made.opacities > 0.5)
    assert kept[0].mean() > 0.99
    assert kept[2].mean() > 0.1


def test_without_features_everything_stays() -> None:
    scene, recovered = wall(2)
    wrong, there = misplace(scene, recovered, [1])
    other, _ = wall(2, seed=1)
    for images in (np.full_like(scene.images, 0.5), np.stack([scene.images[0], other.images[1]])):
        made, found = placed(replace(wrong, images=images), there)
        np.testing.assert_array_equal(made.means, wrong.means)
        assert errors(found, recovered) == errors(there, recovered)
        assert found.notes == []


def test_points_that_are_not_finite_do_not_decide() -> None:
    scene, recovered = wall(2)
    wrong, there = misplace(scene, recovered, [1])
    wrong.means[1, ::5] = np.nan
    wrong.means[0, :, ::7] = np.inf
    _, found = placed(wrong, there)
    assert max(errors(found, recovered)) < 1.5


def test_threads_change_nothing() -> None:
    wrong, there = misplace(*wall(3), [2])
    one, two = (placed(wrong, there, threads) for threads in (1, 3))
    np.testing.assert_array_equal(one[0].means, two[0].means)
    assert one[1].notes == two[1].notes


CHECKERS = np.indices((SIDE, SIDE)).sum(axis=0) % 2


@pytest.mark.parametrize(
    "pictures",
    [
        np.zeros((SIDE, SIDE)),
        CHECKERS,
        np.kron(CHECKERS[:12, :12], np.ones((SIDE // 12, SIDE // 12))),
        np.random.default_rng(0).random((SIDE, SIDE)),
        wall(1)[0].images[0].mean(axis=0),
    ],
    ids=["black", "checkers", "squares", "noise", "wall"],
)
def test_views_that_are_all_alike_have_a_place(pictures: NDArray[np.float64]) -> None:
    """Repeated and identical pictures: any answer is finite and rigid."""
    scene, recovered = misplace(*wall(3), [1])
    images = np.broadcast_to(pictures, scene.images.shape).astype(np.float32)
    made, found = placed(replace(scene, images=images), recovered)
    assert np.isfinite(made.means).all()
    for camera in found.cameras:
        turn = camera.extrinsics[:3, :3]
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-6)


@pytest.mark.parametrize("broken", ["means", "opacities"])
def test_scenes_of_numbers_that_are_none_pass(broken: str) -> None:
    scene, recovered = wall(2)
    wrong, there = misplace(scene, recovered, [1])
    nothing = np.full_like(getattr(wrong, broken), np.nan)
    made, found = placed(replace(wrong, **{broken: nothing}), there)
    assert all(np.isfinite(camera.extrinsics).all() for camera in found.cameras)
    assert np.isnan(getattr(made, broken)).any() or broken == "opacities"
