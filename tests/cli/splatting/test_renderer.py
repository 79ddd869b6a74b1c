"""The splat renderer against the formula, and what must hold of any picture."""

from __future__ import annotations

import multiprocessing
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from splat_oracle import draw

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.splatting import render, tiles
from styl3r_cli.splatting.projection import VISIBLE, near_plane, project

TOLERANCE = 1e-4

# A threshold that falls the other way changes a pixel by at most one splat of alpha 1/255 (times
# colours up to 1, and what it hides).
BORDERLINE_TOLERANCE = 2 / 255


def make_scene(seed: int, count: int, spread: float = 1.0, size: float = 0.1) -> Gaussians:
    """Random Gaussians around z = 3, of every shape."""
    rng = np.random.default_rng(seed)
    return Gaussians(
        rng.normal(0, spread, (count, 3)) + np.array([0, 0, 3]),
        size * np.exp(rng.normal(0, 1, (count, 3))),
        Rotation.random(count, random_state=seed).as_quat(scalar_first=True),
        rng.uniform(0, 1, count),
        rng.uniform(0, 1, (count, 3)),
    )


def make_camera(width: int = 48, height: int = 40, **changes) -> Camera:
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("xyz", [5, -8, 12], degrees=True).as_matrix()
    turn[:3, 3] = [0.1, -0.2, 0.3]
    camera = Camera(turn, 40.0, 45.0, width / 2, height / 2, width, height)
    return replace(camera, **changes)


def assert_drawn(
    gaussians: Gaussians, camera: Camera, background=(0.2, 0.5, 0.9), antialias=False
) -> None:
    """The renderer's frame is the formula's."""
    near = near_plane(gaussians.means)
    frame = render(gaussians, camera, background, antialias=antialias)
    expected = draw(gaussians, camera, background, near, antialias)
    assert frame.invalid == 0
    assert frame.colour.dtype == frame.alpha.dtype == frame.depth.dtype == np.float32
    reach = max(1.0, float(expected.depth.max()))
    errors = np.maximum(
        np.abs(frame.colour - expected.colour).max(axis=-1), np.abs(frame.alpha - expected.alpha)
    )
    inside = ~expected.borderline
    assert errors[inside].max(initial=0) <= TOLERANCE
    assert (np.abs(frame.depth - expected.depth) / reach)[inside].max(initial=0) <= TOLERANCE
    sure = inside & ~expected.median_borderline
    medians = np.abs(frame.median_depth - expected.median_depth) / reach
    assert medians[sure].max(initial=0) <= TOLERANCE
    assert errors.max() <= BORDERLINE_TOLERANCE * max(1, gaussians.colours.max(initial=0))
    assert expected.borderline.mean() < 0.2


@pytest.mark.parametrize("seed", range(6))
def test_a_random_scene_is_drawn_as_the_formula_says(seed):
    assert_drawn(make_scene(seed, 150), make_camera())


@pytest.mark.parametrize("seed", range(12))
def test_hundreds_of_gaussians_from_any_side(seed):
    scene = make_scene(100 + seed, 400, spread=1.5, size=0.06)
    turn = np.eye(4)
    turn[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    turn[:3, 3] = turn[:3, :3] @ [0, 0, -3] + [0, 0, 3.5]
    focal = 30.0 + 10 * seed
    assert_drawn(scene, replace(make_camera(), extrinsics=turn, fx=focal, fy=1.1 * focal))


@pytest.mark.parametrize("size", [0.002, 0.02, 0.2])
def test_antialiasing_keeps_what_a_splat_weighs(size):
    assert_drawn(make_scene(25, 200, size=size), make_camera(), antialias=True)
    one = Gaussians([[0, 0, 3]], [[0.02] * 3], [[1, 0, 0, 0]], [0.9], [[1, 1, 1]])
    totals = [
        render(one, Camera(np.eye(4), f, f, 40.25, 40.75, 80, 80), near=0.0, antialias=True)
        .alpha.sum() for f in (40.0, 80.0, 400.0, 1600.0)
    ]  # fmt: skip
    areas = 0.9 * 2 * np.pi * (0.02 / 3 * np.array([40.0, 80.0, 400.0, 1600.0])) ** 2
    # Alphas below 1/255 are cut off, which small and faint splats lose most to.
    assert totals[0] <= areas[0] * 1.001
    np.testing.assert_allclose(totals[2:], areas[2:], rtol=0.03)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 37), (16, 16), (17, 15), (65, 33)])
def test_a_frame_of_any_size(width, height):
    assert_drawn(make_scene(7, 120), make_camera(width, height))


@pytest.mark.parametrize(
    "lens",
    [
        {"cx": 3.25, "cy": 37.5},
        {"cx": -20.0, "cy": 60.0},
        {"cx": 90.0},
        {"fx": 12.0, "fy": 90.0},
        {"fx": 900.0, "fy": 950.0},
        {"fx": 8.0, "fy": 8.0},
    ],
)
def test_a_principal_point_and_focal_lengths_of_any_kind(lens):
    assert_drawn(make_scene(8, 120), make_camera(**lens))


def test_a_camera_among_the_gaussians_sees_those_in_front():
    scene = make_scene(9, 200, spread=2.0)
    camera = make_camera()
    camera.extrinsics[:3, 3] = [0, 0, -3]
    in_view = scene.means @ camera.extrinsics[:3, :3].T + camera.extrinsics[:3, 3]
    assert 60 < (in_view[:, 2] < 0).sum() < 140
    assert_drawn(scene, camera)


def test_needles_and_discs():
    rng = np.random.default_rng(10)
    scene = make_scene(10, 80)
    needles = np.stack([np.full(80, 1e-6), np.full(80, 1e-4), rng.uniform(1, 50, 80)], -1)
    discs = np.stack([np.full(80, 0.0), rng.uniform(0, 1, 80), rng.uniform(0, 1, 80)], -1)
    assert_drawn(replace(scene, scales=needles), make_camera())
    assert_drawn(replace(scene, scales=discs), make_camera())


def test_points_and_giants():
    scene = make_scene(11, 60)
    assert_drawn(replace(scene, scales=np.zeros((60, 3))), make_camera())
    assert_drawn(replace(scene, scales=np.full((60, 3), 1e4)), make_camera())


@pytest.mark.parametrize("opacity", [0.0, 0.99 / 255, 1.02 / 255, 0.5, 1.0])
def test_opacities(opacity):
    scene = replace(make_scene(12, 100), opacities=np.full(100, opacity))
    assert_drawn(scene, make_camera())


def test_many_opaque_layers_stop_a_pixel():
    scene = make_scene(13, 300, spread=0.3, size=0.5)
    scene = replace(scene, opacities=np.full(300, 0.97))
    assert_drawn(scene, make_camera())
    assert (1 - render(scene, make_camera()).alpha).max() < 1e-2


def test_equal_depths_are_drawn_in_the_order_of_the_arrays():
    count = 40
    scene = make_scene(14, count)
    means = scene.means.copy()
    means[:, 2] = 2.0
    camera = replace(make_camera(), extrinsics=np.eye(4))
    assert_drawn(replace(scene, means=means), camera)
    red_first = Gaussians(
        [[0, 0, 2]] * 2, [[1, 1, 1]] * 2, [[1, 0, 0, 0]] * 2, [1, 1], [[1, 0, 0], [0, 1, 0]]
    )
    colour = render(red_first, camera).colour[20, 24]
    assert colour[0] > 0.9 > 0.1 > colour[1]


def test_far_away_frames_of_a_large_picture_are_exact():
    scene = make_scene(15, 30, size=0.002)
    camera = make_camera(64, 48, fx=40_000.0, fy=40_000.0, cx=-9000.0, cy=-15_000.0)
    inside = np.linalg.inv(camera.extrinsics) @ np.array([9020 / 4e4, 15_020 / 4e4, 1, 0])
    means = inside[:3] * np.linspace(2, 4, 30)[:, None] + np.linalg.inv(camera.extrinsics)[:3, 3]
    assert render(replace(scene, means=means), camera).alpha.max() > 0.5
    assert_drawn(replace(scene, means=means), camera)


def test_no_gaussians_leave_the_background():
    frame = render(make_scene(0, 0), make_camera(5, 3), (0.1, 0.2, 0.3))
    np.testing.assert_allclose(frame.colour, np.broadcast_to([0.1, 0.2, 0.3], (3, 5, 3)))
    assert not frame.alpha.any()
    assert not frame.depth.any()


def test_invalid_gaussians_are_left_out_and_counted():
    scene = make_scene(16, 50)
    broken = {
        "means": [np.nan, np.inf],
        "scales": [np.nan, np.inf, -0.1],
        "rotations": [np.nan, -np.inf],
        "opacities": [np.nan, np.inf],
        "colours": [np.nan, -np.inf],
    }
    parts = {name: [getattr(scene, name)] for name in broken}
    count = 0
    for name, values in broken.items():
        for value in values:
            for other in broken:
                array = getattr(scene, other)[:1].copy()
                if other == name:
                    array.flat[0] = value
                parts[other].append(array)
            count += 1
    both = Gaussians(**{name: np.concatenate(arrays) for name, arrays in parts.items()})
    rotations = both.rotations.copy()
    rotations[-1] = 0
    both = replace(both, rotations=rotations)
    near = near_plane(scene.means)
    clean, repaired = (
        render(scene, make_camera(), near=near),
        render(both, make_camera(), near=near),
    )
    assert (clean.invalid, repaired.invalid) == (0, count)
    np.testing.assert_array_equal(repaired.colour, clean.colour)


@pytest.mark.parametrize("value", [1e-38, 1e-40, 1e20, 3e38])
def test_valid_extremes_are_not_invalid(value):
    scene = make_scene(17, 1)
    for name in ("means", "scales", "rotations", "opacities", "colours"):
        array = getattr(scene, name).copy()
        array.flat[-1] = value
        frame = render(replace(scene, **{name: array}), make_camera(), near=0.01)
        assert frame.invalid == 0, name
        assert np.isfinite(frame.alpha).all(), name
        assert np.isfinite(frame.depth).all(), name


def test_negative_colours_count_as_black():
    scene = make_scene(18, 60)
    negative = replace(scene, colours=scene.colours - 0.5)
    black = replace(scene, colours=np.maximum(scene.colours - 0.5, 0))
    frame = render(negative, make_camera())
    np.testing.assert_array_equal(frame.colour, render(black, make_camera()).colour)
    assert frame.colour.min() >= 0


def test_no_background_is_black():
    scene = make_scene(19, 60)
    np.testing.assert_array_equal(
        render(scene, make_camera(), None).colour, render(scene, make_camera(), (0, 0, 0)).colour
    )


@pytest.mark.parametrize("size", [0.01, 0.1, 1.0])
def test_threads_and_bands_and_tiles_do_not_change_a_bit(monkeypatch, size):
    scene, camera = make_scene(20, 500, size=size), make_camera(100, 90)
    means = scene.means.copy()
    means[::7] = means[0]  # equal depths too
    scene = replace(scene, means=means)
    one = render(scene, camera, threads=1)
    for threads, tile, budget in [(1, 8, 10**6), (2, 16, 50), (7, 16, 1), (3, 32, 500), (1, 64, 9)]:
        monkeypatch.setattr(tiles, "PAIR_BUDGET", budget)
        frame = render(scene, camera, threads=threads, tile=tile)
        for name in ("colour", "alpha", "depth", "median_depth"):
            np.testing.assert_array_equal(getattr(frame, name), getattr(one, name), name)


@pytest.mark.parametrize("tile", [0, -16, 4, 20])
def test_tiles_of_other_sizes_are_refused(tile):
    with pytest.raises(ValueError, match="tiles"):
        render(make_scene(0, 3), make_camera(), tile=tile)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), stretch=st.floats(0.1, 100))
def test_lists_hold_the_tiles_that_a_splat_reaches_and_no_others(seed, stretch):
    scene = make_scene(seed, 12, size=0.05)
    scales = scene.scales * np.float32([stretch, 1, 0.1])
    camera = make_camera(96, 80, fx=90.0, fy=80.0)
    splats = project(replace(scene, scales=scales), camera, 0.01, 1)
    (band,) = tiles.tile_lists(splats, 96, 80, 16, 1)
    for i in np.flatnonzero(splats.status == VISIBLE):
        listed = np.array([i in band.members[low:high] for low, high in pairwise(band.starts)])
        assert (listed >= tiles_reached(splats.records[i], 1)).all()
        # The outline may pass between pixels' centres.
        assert (listed & ~tiles_reached(splats.records[i], 4)).sum() <= 2


def tiles_reached(record: np.ndarray, samples: int) -> np.ndarray:
    """Which of 6x5 tiles a splat is seen in, looked at in so many places per pixel and axis."""
    u, v, a, b, c, log_opacity = record[:6]
    dx = (np.arange(96 * samples) + 0.5) / samples - u
    dy = ((np.arange(80 * samples) + 0.5) / samples - v)[:, None]
    seen = log_opacity - (a * dx + b * dy) ** 2 - (c * dy) ** 2 >= np.log2(1 / 255)
    return seen.reshape(5, 16 * samples, 6, 16 * samples).any(axis=(1, 3)).ravel()


def test_many_gaussians_in_few_tiles_come_in_order():
    rng = np.random.default_rng(26)
    scene = make_scene(26, 5000, spread=0.02, size=0.01)
    means = scene.means.copy()
    means[:, 2] = rng.choice(np.float32([1e-3, 0.7, 2, 2.0000002, 60, 1e9]), 5000)
    splats = project(replace(scene, means=means), make_camera(extrinsics=np.eye(4)), 0.0, 2)
    for band in tiles.tile_lists(splats, 48, 40, 16, 2):
        for low, high in pairwise(band.starts):
            mine = band.members[low:high]
            depths = splats.records[mine, 6].astype(np.float32)
            np.testing.assert_array_equal(np.lexsort((mine, depths)), np.arange(len(mine)))


def test_the_order_of_the_gaussians_does_not_change_a_bit():
    scene = make_scene(21, 300)
    shuffled = scene.select(np.random.default_rng(0).permutation(300))
    near = near_plane(scene.means)
    np.testing.assert_array_equal(
        render(scene, make_camera(), near=near).colour,
        render(shuffled, make_camera(), near=near).colour,
    )


@pytest.mark.parametrize("unit", [1e-5, 1e5])
def test_the_unit_of_length_does_not_matter(unit):
    scene, camera = make_scene(22, 200, spread=2.0), make_camera()
    extrinsics = camera.extrinsics.copy()
    extrinsics[:3, 3] *= unit
    scaled = replace(scene, means=scene.means * unit, scales=scene.scales * unit)
    expected, frame = render(scene, camera), render(scaled, replace(camera, extrinsics=extrinsics))
    differs = np.abs(frame.colour - expected.colour).max(axis=-1) > 1e-4
    assert differs.mean() < 0.01  # float32 means move by an ulp; thresholds may fall otherwise
    np.testing.assert_allclose(
        frame.depth[~differs], expected.depth[~differs] * unit, rtol=1e-2, atol=1e-3 * unit
    )


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(0, 60), size=st.floats(1e-3, 3))
def test_a_picture_stays_within_the_hull_of_its_colours(seed, count, size):
    scene = make_scene(seed, count, size=size)
    frame = render(scene, make_camera(20, 18), (0.25, 0.5, 0.75))
    assert frame.alpha.min() >= 0
    assert frame.alpha.max() <= 1
    assert frame.colour.min() >= 0
    assert frame.colour.max() <= max(scene.colours.max(initial=0), 0.75) + 1e-5
    seen = frame.alpha > 0
    in_view = scene.means @ make_camera().extrinsics[2, :3] + make_camera().extrinsics[2, 3]
    assert (frame.depth[~seen] == 0).all()
    assert (frame.depth[seen] <= in_view.max(initial=0) * 1.001).all()
    assert (frame.depth[seen] > 0).all()


@pytest.mark.parametrize("changes", [{"fx": 0.0}, {"fy": -1.0}, {"cx": np.nan}, {"width": 0}])
def test_an_impossible_camera_is_refused(changes):
    with pytest.raises(ValueError, match="camera"):
        render(make_scene(0, 3), make_camera(**changes))


def test_the_near_plane_follows_the_scene():
    means = make_scene(23, 1000).means
    assert near_plane(means * 100) == pytest.approx(100 * near_plane(means), rel=1e-5)
    assert near_plane(means + np.float32([50, 0, 0])) == pytest.approx(near_plane(means), rel=1e-3)
    assert near_plane(np.full((3, 3), np.nan, np.float32)) == 0


def _render_in_child(queue: multiprocessing.Queue) -> None:
    queue.put(render(make_scene(24, 50), make_camera(), threads=2).colour)


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork here")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_can_render():
    expected = render(make_scene(24, 50), make_camera(), threads=2).colour
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_render_in_child, args=(queue,), daemon=True)
    child.start()
    np.testing.assert_array_equal(queue.get(timeout=60), expected)
    child.join(10)
