"""One surface, one painting: what views see twice keeps one view's strokes and Gaussians."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.recover import Recovered
from styl3r_cli.gaussians import FloatArray
from styl3r_cli.overlaps import Overlaps, outwards
from styl3r_cli.pipeline import Scene

SIDE, FOCAL = 48, 48.0
WALL, BOX = 4.0, 2.0
STEP = 0.5  # six pixels of the wall, twelve of the box
TINTS = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)


def views(count: int, box: bool = False) -> tuple[Scene, Recovered]:
    """Cameras in a row before a wall, with a box in front of it if asked for: exact depth."""
    centres = (np.arange(SIDE) + 0.5 - SIDE / 2) / FOCAL
    x, y = np.meshgrid(centres, centres)
    means, cameras = [], []
    for k in range(count):
        depth = np.full((SIDE, SIDE), WALL)
        if box:  # 0.75 x 1, its left edge at x = 0
            at = x * BOX + k * STEP
            depth[(at >= 0) & (at < 0.75) & (np.abs(y * BOX) < 0.5)] = BOX
        means.append(np.stack((x * depth + k * STEP, y * depth, depth), -1))
        pose = np.eye(4)
        pose[0, 3] = -k * STEP
        cameras.append(Camera(pose, FOCAL, FOCAL, SIDE / 2, SIDE / 2, SIDE, SIDE))
    shape = (count, SIDE, SIDE)
    scene = Scene(
        images=np.zeros((count, 3, SIDE, SIDE), np.float32),
        intrinsics=np.tile(
            np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]], np.float32), (count, 1, 1)
        ),
        means=np.asarray(means, np.float32),
        scales=np.full((*shape, 3), 0.01, np.float32),
        rotations=np.tile(np.array([1, 0, 0, 0], np.float32), (*shape, 1)),
        opacities=np.ones(shape, np.float32),
        content_tokens=np.zeros((count, 4, 8), np.float32),
    )
    return scene, Recovered(cameras, [1.0] * count, [True] * count, None, None, [])


def flat(count: int) -> FloatArray:
    """Each view painted in a colour of its own."""
    return np.tile(TINTS[:count, None, None], (1, SIDE, SIDE, 1))


def test_a_surface_seen_twice_keeps_one_painting() -> None:
    scene, recovered = views(2)
    painted = Overlaps(scene, recovered).paint_once(flat(2))
    np.testing.assert_array_equal(painted[0], flat(2)[0])
    # The second view sees the first's right part, shifted six pixels to the left.
    np.testing.assert_allclose(painted[1, 6:-6, : SIDE - 6 - 5], painted[0, 6:-6, 11:], atol=1e-6)
    np.testing.assert_array_equal(painted[1, :, SIDE - 6 + 1 :], flat(2)[1, :, SIDE - 6 + 1 :])


def test_strokes_are_taken_from_where_the_same_points_are() -> None:
    """Against the pattern itself, at each pixel's point on the wall."""
    scene, recovered = views(2)
    pattern = 0.5 + 0.4 * np.sin(4 * scene.means[..., :1] + 3 * scene.means[..., 1:2] + [0, 1, 2])
    pictures = pattern.astype(np.float32)
    pictures[1] = 0
    painted = Overlaps(scene, recovered).paint_once(pictures)
    np.testing.assert_allclose(
        painted[1, 6:-6, : SIDE - 12], pattern[1, 6:-6, : SIDE - 12], atol=2e-3
    )


def test_what_stands_behind_is_not_painted_with_what_stands_before_it() -> None:
    scene, recovered = views(2, box=True)
    pictures = flat(2)
    pictures[0][scene.means[0, ..., 2] == BOX] = 1  # a white box
    painted = Overlaps(scene, recovered).paint_once(pictures)
    box = scene.means[1, ..., 2] == BOX
    inner = box.copy()
    for shift in (-3, 3):
        inner &= np.roll(box, shift, 0) & np.roll(box, shift, 1)
    assert inner.sum() > 100
    white = painted[1].min(axis=-1)
    np.testing.assert_allclose(white[inner], 1, atol=1e-5)
    assert white[~box].max() < 0.05


def test_a_view_far_off_is_painted_by_the_nearest_that_knows() -> None:
    """The middle view paints first; what only an outer one saw, the next does not have to share."""
    scene, recovered = views(3)
    painted = Overlaps(scene, recovered).paint_once(flat(3))
    middle = SIDE // 2
    for view in range(3):
        np.testing.assert_allclose(painted[view, middle, middle], TINTS[1], atol=1e-6)
    np.testing.assert_allclose(painted[0, middle, 0], TINTS[0], atol=1e-6)
    np.testing.assert_allclose(painted[2, middle, -1], TINTS[2], atol=1e-6)


@pytest.mark.parametrize("strength", [0.0, 0.25, 1.0])
def test_strength_says_how_much_is_taken_over(strength: float) -> None:
    scene, recovered = views(2)
    painted = Overlaps(scene, recovered).paint_once(flat(2), strength)
    middle = painted[1, SIDE // 2, SIDE // 2]
    np.testing.assert_allclose(middle, strength * TINTS[0] + (1 - strength) * TINTS[1], atol=1e-6)


def test_a_view_without_a_camera_neither_gives_nor_takes() -> None:
    scene, recovered = views(3)
    lost = replace(recovered, recovered=[True, False, True])
    painted = Overlaps(scene, lost).paint_once(flat(3))
    np.testing.assert_array_equal(painted[1], flat(3)[1])
    assert not (painted[[0, 2]][..., 1] > 0).any()


def test_points_that_are_nowhere_take_nothing() -> None:
    scene, recovered = views(2)
    scene.means[1, 3:5] = np.nan
    scene.means[1, 5:7] = np.inf
    scene.means[1, 7:9, :, 2] = -1
    scene.means[1, 9:11] *= np.float32(1e30)
    scene.means[0, 20:22] = np.nan
    painted = Overlaps(scene, recovered).paint_once(flat(2))
    assert np.isfinite(painted).all()
    np.testing.assert_array_equal(painted[1, 3:9], flat(2)[1, 3:9])
    assert painted.min() >= -1e-6
    assert painted.max() <= 1 + 1e-6


def test_a_view_that_comes_close_keeps_its_own_strokes() -> None:
    """Enlarged three times, another view's strokes would be a blur."""
    scene, recovered = views(2)
    near = recovered.cameras[1].extrinsics.copy()
    near[:3, 3] = 0, 0, -(WALL - WALL / 3)
    centres = (np.arange(SIDE) + 0.5 - SIDE / 2) / FOCAL * WALL / 3
    x, y = np.meshgrid(centres, centres)
    scene.means[1] = np.stack((x, y, np.full_like(x, WALL)), -1)
    cameras = [recovered.cameras[0], replace(recovered.cameras[1], extrinsics=near)]
    painted = Overlaps(scene, replace(recovered, cameras=cameras)).paint_once(flat(2))
    np.testing.assert_array_equal(painted[1], flat(2)[1])


def test_the_order_goes_outwards_from_the_middle() -> None:
    assert outwards(4, [0, 1, 2, 3]) == [1, 0, 2, 3]
    assert outwards(5, [0, 1, 3, 4]) == [1, 3, 0, 4]


def test_gaussians_that_repeat_another_views_are_left_out_but_for_a_band() -> None:
    """The second view sees the first's wall but for its last six columns."""
    scene, recovered = views(2)
    kept = Overlaps(scene, recovered).kept
    assert kept[0].all()
    assert not kept[1, 8:-8, : SIDE - 6 - 8].any()
    assert kept[1, :, SIDE - 6 - 3 :].all()


def test_of_a_box_before_a_wall_each_surface_is_kept_once() -> None:
    """What is behind the box in one view is the other view's to keep."""
    scene, recovered = views(2, box=True)
    overlaps = Overlaps(scene, recovered)
    hidden = overlaps.own[1] > 0.99  # of the wall, and the frame's border
    box = scene.means[1, ..., 2] == BOX
    wall = ~box & hidden & overlaps.kept[1]
    beside = np.argwhere(wall[SIDE // 2]).ravel()
    assert len(beside) >= 6  # the parallax between box and wall
    assert (~overlaps.kept[1] & box).sum() > 60


def test_what_stays_covers_as_much_as_it_did_with_its_repeats() -> None:
    scene, recovered = views(2)
    scene.opacities[0], scene.opacities[1] = 0.8, 0.5
    merged = Overlaps(scene, recovered).opacities(scene.opacities)
    np.testing.assert_allclose(merged[0, 8:-8, 20:-8], 1 - 0.2 * 0.5, atol=1e-6)
    np.testing.assert_allclose(merged[0, :, :6], 0.8, atol=1e-6)  # seen by the first alone
    assert (merged[1][~Overlaps(scene, recovered).kept[1]] == 0).all()


def test_damaged_opacities_stay_their_own() -> None:
    scene, recovered = views(2)
    scene.opacities[...] = 0.8
    scene.opacities[1, 20:23, 10:20] = np.nan
    scene.opacities[1, 24:26] = 7
    merged = Overlaps(scene, recovered).opacities(scene.opacities)
    assert np.isfinite(merged).all()
    assert 0 <= merged.min() <= merged[0].max() <= 1  # what stays of the second is clamped later
    scene.opacities[0, 5, 5] = np.nan  # of one that stays: dropped later, and counted
    assert np.isnan(Overlaps(scene, recovered).opacities(scene.opacities)[0, 5, 5])


def test_a_view_without_a_camera_repeats_nothing() -> None:
    scene, recovered = views(3)
    lost = replace(recovered, recovered=[True, False, True])
    assert Overlaps(scene, lost).kept[1].all()


def floater(count: int, seen_by: tuple[int, ...] = (0,)) -> tuple[Scene, Recovered, FloatArray]:
    """A wall, before which some views have a patch half as far that the others do not see."""
    scene, recovered = views(count)
    patch = np.zeros((count, SIDE, SIDE), np.bool_)
    eyes = np.arange(count)[:, None, None] * STEP
    place = scene.means[..., 0] / 2 + eyes / 2, scene.means[..., 1] / 2  # halfway to the wall
    for view in seen_by:
        patch[view] = (np.abs(place[0][view] - 0.5) < 0.3) & (np.abs(place[1][view]) < 0.3)
    half = scene.means.copy()
    half[..., 0] = place[0]
    half[..., 1:] /= 2
    scene.means[...] = np.where(patch[..., None], half, scene.means)
    return scene, recovered, patch


def test_what_two_views_look_through_and_no_other_sees_is_left_out() -> None:
    scene, recovered, patch = floater(3)
    assert patch.sum() > 80
    kept = Overlaps(scene, recovered).kept
    assert not kept[0][patch[0]].any()
    scene, recovered, patch = floater(2)  # one view's word against another's
    assert Overlaps(scene, recovered).kept[0][patch[0]].all()


def test_what_another_view_sees_as_well_stays_though_two_look_through_it() -> None:
    scene, recovered, patch = floater(4, seen_by=(0, 1))
    kept = Overlaps(scene, recovered).kept
    inner = patch[1] & (np.abs(scene.means[1, ..., 0] - 0.5) < 0.2)
    assert inner.sum() > 20
    assert kept[1][inner].all()


def test_the_other_side_of_a_thin_wall_is_another_surface() -> None:
    """0.2 thick, seen from in front of it and from behind it, 4 away: as near as repeats are."""
    scene, recovered = views(2)
    behind = np.diag([-1.0, 1.0, -1.0, 1.0])
    behind[:3, 3] = 0, 0, 2 * WALL + 0.2
    scene.means[1] = scene.means[0] * np.float32([-1, 1, 1]) + np.float32([0, 0, 0.2])
    cameras = [recovered.cameras[0], replace(recovered.cameras[1], extrinsics=behind)]
    overlaps = Overlaps(scene, replace(recovered, cameras=cameras))
    assert overlaps.kept.all()
    np.testing.assert_array_equal(overlaps.paint_once(flat(2)), flat(2))


def test_what_repeats_a_repeat_is_compared_with_what_is_kept() -> None:
    """Each view's wall is 6.5 % farther than the one before: the third's is not the first's."""
    scene, recovered = views(3)
    cameras = [replace(each, extrinsics=np.eye(4)) for each in recovered.cameras]
    first, second, third = outwards(3, [0, 1, 2])
    for view, farther in ((first, 1), (second, 1.065), (third, 1.065**2)):
        centres = (np.arange(SIDE) + 0.5 - SIDE / 2) / FOCAL * WALL * farther
        x, y = np.meshgrid(centres, centres)
        scene.means[view] = np.stack((x, y, np.full_like(x, WALL * farther)), -1)
    overlaps = Overlaps(scene, replace(recovered, cameras=cameras))
    inner = slice(11, -11)
    assert overlaps.kept[first].all()
    assert not overlaps.kept[second, inner, inner].any()
    assert overlaps.kept[third, inner, inner].all()
