"""What holds of any picture, whatever the scene: hulls, orders, motions, absences and unions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.formats import encode_scene, read_scene
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.splatting import Frame, render
from styl3r_cli.splatting.projection import near_plane

NEAR = 0.05
PARTS = ("means", "scales", "rotations", "opacities", "colours")
PLANES = ("colour", "alpha", "depth", "median_depth")
# Where float32 means move by an ulp, an alpha next to 1/255 may fall to the other side: that much
# of a pixel, times what it hides. All other pixels agree as far as float32 does.
THRESHOLD, ROUNDING, MOST_THRESHOLDS = 2 / 255, 1e-4, 0.02
# Nearly equal depths may change places when they are rounded anew.
LEAST_GAP = 1e-4
# The same examples in every run: no build shall hang on a threshold that one scene in 10^5 meets.
SOME = settings(max_examples=30, deadline=None, derandomize=True)
MANY = settings(SOME, max_examples=60)


@st.composite
def any_scene(draw: st.DrawFn, most: int = 12, largest: float = 1e6) -> Gaussians:
    """Finite Gaussians without any sense; many in view, some of equal depth."""
    count = draw(st.integers(0, most))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    wild = draw(hnp.arrays(bool, count))
    numbers = st.floats(-largest, largest, width=32)
    means = rng.normal(0, 0.8, (count, 3)) + np.array([0, 0, 3])
    means[:, 2] = np.where(rng.random(count) < 0.3, 2.5, means[:, 2])
    scales = 10 ** rng.uniform(-4, 1, (count, 3))
    for array in (means, scales):
        array[wild] = draw(hnp.arrays(np.float32, (int(wild.sum()), 3), elements=numbers))
    return Gaussians(
        means,
        np.abs(scales),
        Rotation.random(count, random_state=0).as_quat(scalar_first=True)
        if count
        else np.empty((0, 4)),
        draw(hnp.arrays(np.float32, count, elements=st.floats(0, 1, width=32))),
        rng.uniform(0, 1, (count, 3)),
    )


@st.composite
def any_camera(draw: st.DrawFn) -> Camera:
    pose = np.eye(4)
    turn = draw(st.tuples(*[st.floats(-0.6, 0.6)] * 3))
    pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    pose[:3, 3] = draw(st.tuples(*[st.floats(-1, 1)] * 3))
    width, height = draw(st.integers(1, 40)), draw(st.integers(1, 40))
    focal = draw(st.floats(2, 200))
    return Camera(
        pose, focal, focal * draw(st.floats(0.5, 2)), width * draw(st.floats(-1, 2)),
        height * draw(st.floats(-1, 2)), width, height,
    )  # fmt: skip


def assert_same_bytes(a: Frame, b: Frame) -> None:
    for name in PLANES:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), name)


def assert_close(a: Frame, b: Frame) -> None:
    """All pixels within a threshold's width, all but a few within float32's rounding."""
    off = np.maximum(np.abs(a.colour - b.colour).max(axis=-1), np.abs(a.alpha - b.alpha))
    assert off.max() <= THRESHOLD
    assert (off > ROUNDING).mean() <= MOST_THRESHOLDS or (off > ROUNDING).sum() <= 1


def depths_in(scene: Gaussians, camera: Camera) -> NDArray[np.float64]:
    return scene.means.astype(np.float64) @ camera.extrinsics[2, :3] + camera.extrinsics[2, 3]


def merged(*scenes: Gaussians) -> Gaussians:
    return Gaussians(*(np.concatenate([getattr(s, part) for s in scenes]) for part in PARTS))


@MANY
@given(any_scene(), any_camera(), st.tuples(*[st.floats(0, 1)] * 3), st.booleans())
def test_finite_shares_within_the_hull(scene, camera, background, antialias) -> None:
    frame = render(scene, camera, background, near=NEAR, antialias=antialias)
    assert frame.invalid == 0
    assert all(np.isfinite(getattr(frame, name)).all() for name in PLANES)
    assert frame.alpha.min() >= 0
    assert frame.alpha.max() <= 1
    colours = np.concatenate([scene.colours, np.float32([background])])
    assert (frame.colour >= colours.min(axis=0) - 1e-6).all()
    assert (frame.colour <= colours.max(axis=0) + 1e-6).all()
    depths = depths_in(scene, camera)
    drawn = depths[depths > NEAR]
    for plane in (frame.depth, frame.median_depth):
        seen = plane[frame.alpha > 0]
        assert (plane[frame.alpha == 0] == 0).all()
        assert (seen >= drawn.min(initial=np.inf) * (1 - 1e-4)).all()
        assert (seen <= drawn.max(initial=0) * (1 + 1e-4)).all()


@SOME
@given(any_scene(), any_camera(), st.sampled_from([8, 16, 24, 64]), st.integers(1, 4))
def test_tiles_and_threads_change_no_byte(scene, camera, tile, threads) -> None:
    one = render(scene, camera, near=NEAR, threads=1)
    assert_same_bytes(one, render(scene, camera, near=NEAR, threads=threads, tile=tile))


@SOME
@given(any_scene(), any_camera(), st.randoms(use_true_random=False))
def test_the_order_changes_no_byte_where_depths_differ(scene, camera, random) -> None:
    depths = depths_in(scene, camera)
    scene = scene.select(np.unique(depths.astype(np.float32), return_index=True)[1])
    order = list(range(len(scene)))
    random.shuffle(order)
    shuffled = scene.select(np.array(order, int))
    assert_same_bytes(render(scene, camera), render(shuffled, camera))  # near planes and all


def test_the_near_plane_of_a_large_scene_does_not_hang_on_the_order() -> None:
    rng = np.random.default_rng(0)
    means = rng.normal(size=(50_000, 3)).astype(np.float32) + np.float32([5, 6, 7])
    away = np.linalg.norm(means - np.median(means, axis=0), axis=1)
    assert near_plane(means) == pytest.approx(0.02 * np.median(away), rel=1e-5)
    assert near_plane(means) == near_plane(means[rng.permutation(50_000)])


@SOME
@given(any_scene(largest=3.0), any_camera(), st.integers(0, 10**6))
def test_a_rigid_motion_of_scene_and_camera_changes_nothing(scene, camera, seed) -> None:
    depths = depths_in(scene, camera)
    order = np.argsort(depths)
    scene = scene.select(order[np.diff(depths[order], prepend=-np.inf) > LEAST_GAP])
    rng = np.random.default_rng(seed)
    turn, shift = Rotation.random(random_state=seed), rng.normal(size=3)
    own = Rotation.from_quat(scene.rotations, scalar_first=True) if len(scene) else None
    moved = replace(
        scene,
        means=turn.apply(scene.means) + shift if own else scene.means,
        rotations=(turn * own).as_quat(scalar_first=True) if own else scene.rotations,
    )
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = turn.as_matrix(), shift
    other = replace(camera, extrinsics=camera.extrinsics @ np.linalg.inv(motion))
    assert_close(render(scene, camera, near=NEAR), render(moved, other, near=NEAR))


@SOME
@given(any_scene(), any_camera(), st.integers(-60, 60))
def test_a_power_of_two_as_the_unit_changes_no_byte(scene, camera, exponent) -> None:
    """Scaling is exact then, so all differences would be the renderer's (depths scale along)."""
    unit = 2.0**exponent
    pose = camera.extrinsics.copy()
    pose[:3, 3] *= unit
    means, scales = scene.means * np.float32(unit), scene.scales * np.float32(unit)
    larger = replace(scene, means=means, scales=scales)
    a, b = render(scene, camera), render(larger, replace(camera, extrinsics=pose))
    np.testing.assert_array_equal(a.colour, b.colour)
    np.testing.assert_array_equal(a.alpha, b.alpha)
    np.testing.assert_array_equal(a.median_depth * np.float32(unit), b.median_depth)


@SOME
@given(any_scene(), any_camera(), st.integers(0, 10**6))
def test_opacity_0_is_absence(scene, camera, seed) -> None:
    gone = np.random.default_rng(seed).random(len(scene)) < 0.5
    faded = replace(scene, opacities=np.where(gone, np.float32(0), scene.opacities))
    a, b = render(faded, camera, near=NEAR), render(scene.select(~gone), camera, near=NEAR)
    assert_same_bytes(a, b)


@SOME
@given(any_scene(), any_camera(), st.floats(0.5, 6))
def test_a_merged_scene_is_the_near_one_over_the_far_one(scene, camera, limit) -> None:
    """Cut where no two depths are equal; pixels that end early may miss 1e-4 of the far one."""
    depths = depths_in(scene, camera)
    close = depths.astype(np.float32) < np.float32(limit)
    near, far = scene.select(close), scene.select(~close)
    front = render(near, camera, None, near=NEAR)
    back = render(far, camera, (0.2, 0.5, 0.9), near=NEAR)
    whole = render(merged(far, near), camera, (0.2, 0.5, 0.9), near=NEAR)
    through = 1 - front.alpha
    assert np.abs(front.colour + through[..., None] * back.colour - whole.colour).max() < 5e-4
    assert np.abs(through * (1 - back.alpha) - (1 - whole.alpha)).max() < 5e-4


@SOME
@given(any_scene(), any_camera())
def test_a_scene_from_its_ply_looks_the_same(scene, camera) -> None:
    """Logits and logarithms in float32 round; nothing in a picture does more than that."""
    back = read_scene(encode_scene(scene).data).gaussians
    np.testing.assert_array_equal(back.means, scene.means)
    assert_close(render(scene, camera, near=NEAR), render(back, camera, near=NEAR))
