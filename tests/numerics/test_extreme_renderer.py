"""The renderer at the ends of what floats can hold: exact, or left out and counted."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from exact_oracle import draw_exactly, everywhere
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.splatting import render
from styl3r_cli.splatting.projection import near_plane

TOLERANCE = 1e-4
BACKGROUND = (0.2, 0.5, 0.9)
MAX = float(np.finfo(np.float32).max)
TINY = float(np.finfo(np.float32).tiny)


def make_scene(seed: int, count: int = 10, size: float = 0.2) -> Gaussians:
    """Random Gaussians around z = 3, of every shape."""
    rng = np.random.default_rng(seed)
    return Gaussians(
        rng.normal(0, 0.7, (count, 3)) + np.array([0, 0, 3]),
        size * np.exp(rng.normal(0, 1, (count, 3))),
        Rotation.random(count, random_state=seed).as_quat(scalar_first=True),
        rng.uniform(0.1, 1, count),
        rng.uniform(0, 1, (count, 3)),
    )


def make_camera(width: int = 14, height: int = 12, **changes) -> Camera:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("xyz", [5, -8, 12], degrees=True).as_matrix()
    pose[:3, 3] = [0.1, -0.2, 0.3]
    camera = Camera(pose, 12.0, 13.0, width / 2, height / 2, width, height)
    return replace(camera, **changes)


def assert_exact(
    scene: Gaussians,
    camera: Camera,
    pixels: NDArray[np.int64] | None = None,
    near: float | None = None,
    empty: bool = False,
    depth_tolerance: float = TOLERANCE,
) -> None:
    """The frame is the formula's; nothing was left out, and there is something to see."""
    near = near_plane(scene.means) if near is None else near
    frame = render(scene, camera, BACKGROUND, near=near)
    pixels = everywhere(camera) if pixels is None else pixels
    expected = draw_exactly(scene, camera, BACKGROUND, near, pixels)
    x, y = pixels.T
    assert frame.invalid == 0
    assert (expected.alpha.max() < 0.01) == empty
    sure = ~expected.borderline
    assert sure.mean() > 0.8
    reach = float(expected.depth.max()) or 1.0
    assert np.abs(frame.colour[y, x] - expected.colour)[sure].max() <= TOLERANCE
    assert np.abs(frame.alpha[y, x] - expected.alpha)[sure].max() <= TOLERANCE
    assert np.abs(frame.depth[y, x] - expected.depth)[sure].max() / reach <= depth_tolerance


def scaled(scene: Gaussians, camera: Camera, unit: float) -> tuple[Gaussians, Camera]:
    pose = camera.extrinsics.copy()
    pose[:3, 3] *= unit
    factor = np.float32(unit)
    return (
        replace(scene, means=scene.means * factor, scales=scene.scales * factor),
        replace(camera, extrinsics=pose),
    )


@pytest.mark.parametrize("unit", [1e-30, 1e-12, 1e-6, 1.0, 1e6, 1e12, 1e30])
def test_any_unit_of_length(unit: float) -> None:
    assert_exact(*scaled(make_scene(1), make_camera(), unit))


@pytest.mark.parametrize("distance", [1e3, 1e6])
def test_a_scene_far_from_the_origin(distance: float) -> None:
    """Means have lost digits there (a float32 step is 0.06 at 1e6); the picture follows them."""
    scene, camera = make_scene(2), make_camera()
    shift = distance * np.array([1.0, -1.0, 1.0])
    pose = camera.extrinsics.copy()
    pose[:3, 3] -= pose[:3, :3] @ shift
    assert_exact(replace(scene, means=scene.means + shift), replace(camera, extrinsics=pose))


@pytest.mark.parametrize(
    "shape",
    [(1e-4, 1e-4, 1e4), (1e-4, 1e4, 1e4), (1e-8, 1e-8, 1.0), (0, 0, 1), (0, 1, 1), (0, 0, 0)],
    ids=["needles", "sheets", "hairs", "lines", "discs", "points"],
)
def test_needles_sheets_and_singular_covariances(shape: tuple[float, ...]) -> None:
    for seed in (3, 4):
        scene = make_scene(seed)
        assert_exact(replace(scene, scales=np.tile(np.float32(shape), (10, 1))), make_camera())


def test_needles_that_end_farther_away_than_integers_reach() -> None:
    """Tilted by 2e-19, one crosses the rows above it 1e20 pixels beside the frame."""
    scene = Gaussians(
        np.float32([[0, 0, 3], [0.1, 0.05, 3.5]]),
        np.full((2, 3), [1e21, 0.05, 0.05], np.float32),
        np.float32([[1, 0, 0, 1e-19], [1, 0, 0, -1e-19]]),
        np.float32([0.6, 0.7]),
        np.float32([[1, 0, 0], [0, 1, 0]]),
    )
    assert_exact(scene, make_camera(48, 64, extrinsics=np.eye(4)), near=0.1)


@pytest.mark.parametrize("size", [1e-30, 1e-8, 1e3, 1e8, 1e30])
def test_dust_and_giants(size: float) -> None:
    assert_exact(make_scene(5, size=size), make_camera())


@pytest.mark.parametrize("length", [1e-45, 1e-38, 1e-20, 1e18, 1e38])
def test_quaternions_of_any_length(length: float) -> None:
    scene = make_scene(6)
    assert_exact(replace(scene, rotations=np.sign(scene.rotations) * length), make_camera())


@pytest.mark.parametrize("degrees", [0.01, 1.0, 90.0, 170.0, 179.0])
def test_fields_of_view(degrees: float) -> None:
    """The scene is as large as the frame (a tenth of it through the widest lenses)."""
    half = np.tan(np.radians(degrees / 2))
    scene = make_scene(7)
    means = scene.means - np.float32([0, 0, 3])
    means[:, :2] *= min(half, 10.0)
    lens = {"fx": 7 / half, "fy": 7 / half, "extrinsics": np.eye(4)}
    scene = replace(
        scene, means=means + np.float32([0, 0, 3]), scales=scene.scales * min(half, 1.0)
    )
    assert_exact(scene, make_camera(**lens))


@pytest.mark.parametrize(("cx", "cy"), [(-40.0, 6.0), (7.0, 60.0), (1e4, -1e4)])
def test_principal_points_outside_the_frame(cx: float, cy: float) -> None:
    scene, camera = make_scene(8), make_camera(cx=cx, cy=cy, extrinsics=np.eye(4))
    towards = np.array([(7 - cx) / camera.fx, (6 - cy) / camera.fy, 0]) * scene.means[:, 2:]
    scales = scene.scales * np.float32(1 + np.abs(towards).max() / 10)
    scene = replace(scene, means=scene.means + towards, scales=scales)
    assert_exact(scene, camera, near=0.01)


def test_behind_at_and_straddling_the_near_plane() -> None:
    """One float32 step decides; what lies at or behind the plane or the camera is not drawn."""
    camera = make_camera(extrinsics=np.eye(4))
    near = float(np.float32(0.7))
    for z, drawn in [
        (np.nextafter(np.float32(near), np.float32(1)), True), (np.float32(near), False),
        (np.nextafter(np.float32(near), np.float32(0)), False), (np.float32(0), False),
        (np.float32(-0.0), False), (np.float32(-1), False),
    ]:  # fmt: skip
        one = make_scene(9, 1)
        one = replace(one, means=np.float32([[0, 0, z]]))
        assert_exact(one, camera, near=near, empty=not drawn)


@pytest.mark.parametrize("z", [-1.0, 1e-3, 0.05, 0.5])
def test_a_camera_inside_a_gaussian(z: float) -> None:
    """A fog of radius 2 around the camera, in front of a scene; seen iff its centre is."""
    scene = make_scene(10, 6)
    fog = Gaussians([[0.01, -0.01, z]], [[2, 2, 2]], [[1, 0, 0, 0]], [0.6], [[1, 0, 0]])
    parts = ("means", "scales", "rotations", "opacities", "colours")
    both = Gaussians(*(np.concatenate([getattr(scene, p), getattr(fog, p)]) for p in parts))
    camera = make_camera(extrinsics=np.eye(4))
    assert_exact(both, camera, near=1e-4)
    differs = render(both, camera, near=1e-4).alpha != render(scene, camera, near=1e-4).alpha
    assert differs.any() == (z > 0)


def test_the_farthest_depths_do_not_round_to_infinity() -> None:
    """The mean depth of one splat is (alpha z) / alpha: an ulp too much, next to float32's end."""
    camera = make_camera(extrinsics=np.eye(4))
    for z in (MAX, float(np.nextafter(np.float32(MAX), np.float32(0))), 0.499 * MAX):
        for opacity in np.linspace(0.01, 1, 50):
            one = Gaussians([[0, 0, z]], [[z / 10] * 3], [[1, 0, 0, 0]], [opacity], [[1, 1, 1]])
            frame = render(one, camera, BACKGROUND, near=0.0)
            assert_sound(frame, one)
            assert (frame.alpha.max() > 0) == (z < 0.5 * MAX)


def test_subnormal_depths() -> None:
    """Float32 has three digits left there; the depth has no more."""
    scene, camera = make_scene(11, 4), make_camera(extrinsics=np.eye(4))
    tiny = np.float32(1e-42)
    small = replace(scene, means=scene.means * tiny, scales=scene.scales * tiny)
    assert_exact(small, camera, near=0.0, depth_tolerance=0.1)


POISON = [np.nan, -np.nan, np.inf, -np.inf, 0.0, -0.0, TINY, -TINY, 1e-40, -1e-40, 1e-45,
          float(np.finfo(np.float32).eps), 1e20, -1e20, 1e38, -1e38, MAX, -MAX, 0.01, 1e10,
          1 / 255, 16.0, 0.99, 1e-4]  # fmt: skip
SLOTS = [(name, k) for name, width in
         [("means", 3), ("scales", 3), ("rotations", 4), ("opacities", 1), ("colours", 3)]
         for k in range(width)]  # fmt: skip


def assert_sound(frame, scene: Gaussians) -> None:
    """Finite, alpha a share, colours within the hull of what is drawn and the background."""
    for name in ("colour", "alpha", "depth", "median_depth"):
        assert np.isfinite(getattr(frame, name)).all(), name
        assert getattr(frame, name).min() >= 0, name
    assert frame.alpha.max() <= 1
    finite = scene.colours[np.isfinite(scene.colours).all(axis=1)]
    assert float(frame.colour.max()) <= max(float(finite.max(initial=0)), *BACKGROUND) * (1 + 1e-5)


@pytest.mark.parametrize("antialias", [False, True])
def test_every_poison_in_every_slot_is_drawn_or_counted(antialias: bool) -> None:
    """A value that is not finite, or a negative scale, removes its Gaussian and no other."""
    scene, camera = make_scene(12, 3), make_camera()
    without = scene.select(np.array([0, 2]))
    clean = render(without, camera, BACKGROUND, near=0.01, antialias=antialias)
    for (name, k), value in product(SLOTS, POISON):
        array = getattr(scene, name).copy()
        array.reshape(3, -1)[1, k] = value
        poisoned = replace(scene, **{name: array})
        with np.errstate(all="raise"):
            frame = render(poisoned, camera, BACKGROUND, near=0.01, antialias=antialias)
        assert_sound(frame, poisoned)
        bad = not np.isfinite(array).all() or (name == "scales" and array.min() < 0)
        assert frame.invalid == bad, (name, k, value)
        if bad:
            np.testing.assert_array_equal(frame.colour, clean.colour)


@pytest.mark.parametrize("slot", ["fx", "fy", "cx", "cy", "near", *range(12)])
def test_every_poison_in_the_camera_is_drawn_or_refused(slot: str | int) -> None:
    scene, camera = make_scene(13, 5), make_camera()
    for value in [*POISON, 1e300, -1e300, 1e-300]:
        near, changed = 0.01, camera
        if slot == "near":
            near = value
        elif isinstance(slot, str):
            changed = replace(camera, **{slot: value})
        else:
            pose = camera.extrinsics.copy()
            pose.flat[slot] = value
            changed = replace(camera, extrinsics=pose)
        refused = not np.isfinite(value) if slot != "near" else np.isnan(value)
        if refused or (slot in ("fx", "fy") and value <= 0):
            with pytest.raises(ValueError, match=r"camera|near plane"):
                render(scene, changed, BACKGROUND, near=near)
        else:
            with np.errstate(all="raise"):
                assert_sound(render(scene, changed, BACKGROUND, near=near), scene)


@pytest.mark.parametrize(("width", "height"), [(8192, 3), (3, 8192)])
def test_frames_of_8k_pixels_have_no_seams(width: int, height: int) -> None:
    """Exact at both ends and in the middle of a long frame, where float32 has no half pixels."""
    rng = np.random.default_rng(14)
    scene = make_scene(14, 24, size=0.02)
    ends = rng.choice([-1.0, 0.0, 1.0], 24)[:, None] * [width > 3, height > 3, 0]
    means = np.array([0, 0, 3]) + 1.5 * ends + rng.normal(0, [0.003, 0.003, 0.5], (24, 3))
    camera = make_camera(width, height, fx=8192.0, fy=8192.0, extrinsics=np.eye(4))
    pixels = everywhere(camera)
    along = pixels[:, 0 if width > 3 else 1]
    chosen = pixels[(along < 24) | (along >= 8192 - 24) | (np.abs(along - 4096) < 12)]
    scene = replace(scene, means=means * (scene.means[:, 2:] / 3))
    assert_exact(scene, camera, chosen, near=0.01)


@pytest.mark.slow
def test_a_whole_8k_frame() -> None:
    scene = make_scene(15, 40, size=0.05)
    camera = make_camera(7680, 4320, fx=7000.0, fy=7000.0)
    pixels = np.random.default_rng(15).integers(0, [7680, 4320], (150, 2))
    pixels[:4] = [[0, 0], [7679, 0], [0, 4319], [7679, 4319]]
    assert_exact(scene, camera, pixels)


@pytest.mark.slow
def test_ten_million_gaussians() -> None:
    """The near half over the far half is the whole."""
    count = 10_000_000
    rng = np.random.default_rng(16)
    means = rng.random((count, 3), np.float32) * np.float32([6, 6, 4]) - np.float32([3, 3, -1])
    means = means[np.argsort(means[:, 2])]
    rotations = np.tile(np.float32([1, 0, 0, 0]), (count, 1))
    scales = np.full((count, 3), 0.004, np.float32)
    opacities = np.full(count, 0.02, np.float32)
    scene = Gaussians(means, scales, rotations, opacities, np.abs(means) / 5)
    camera = make_camera(256, 256, fx=300.0, fy=300.0, extrinsics=np.eye(4))
    whole = render(scene, camera, BACKGROUND, near=0.5)
    assert_sound(whole, scene)
    assert 0.2 < whole.alpha.mean() < 0.98
    half = np.arange(count // 2)
    front = render(scene.select(half), camera, None, near=0.5)
    back = render(scene.select(half + count // 2), camera, BACKGROUND, near=0.5)
    over = front.colour + (1 - front.alpha)[..., None] * back.colour
    assert np.abs(over - whole.colour).max() < 3e-4
