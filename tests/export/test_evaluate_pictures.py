"""Pictures compared: measures against references, and rows on a scene whose answer is known."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from plane_scene import cameras, perfect_prediction, plane_group
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from styl3r_cli.splatting import render
from styl3r_export.evaluate.align import Similarity, align
from styl3r_export.evaluate.consistency import camera_path, consistency_values
from styl3r_export.evaluate.depth import depth_values
from styl3r_export.evaluate.histogram import histogram, histogram_distance
from styl3r_export.evaluate.image_metrics import edge_ssim, psnr, ssim
from styl3r_export.evaluate.novel_views import novel_view_values, warp
from styl3r_export.evaluate.pose_adjustment import adjust_pose
from styl3r_export.evaluate.poses import camera_values
from styl3r_export.evaluate.style import (
    Painting,
    choose_style,
    compare_content,
    compare_style,
    held_out_styles,
)
from styl3r_export.evaluate.teachers import Teachers, features
from styl3r_export.evaluate.warping import splat

WORLD = Similarity(Rotation.from_rotvec([0.4, 1.0, -0.3]).as_matrix(), 0.37, np.array([2, -1, 5.0]))

Array = NDArray[np.float64]


def picture(seed: int, side: int = 40) -> Array:
    noise = np.random.default_rng(seed).normal(size=(side, side, 3))
    smooth = gaussian_filter(noise, (3, 3, 0))
    return np.clip(0.5 + smooth / smooth.std() * 0.2, 0, 1)


@cache
def teachers() -> Teachers:
    beside = Path(__file__).parents[3] / "shared"
    folder = Path(os.environ.get("STYL3R_SHARED", beside)) / "teachers"
    if not folder.is_dir():
        pytest.skip("the teachers are not here (set STYL3R_SHARED to their parent folder)")
    torch.set_num_threads(1)
    return Teachers.load(folder, threads=1)


def check_file(name: str) -> dict[str, NDArray[np.float32]]:
    beside = Path(__file__).parents[3] / "shared"
    path = Path(os.environ.get("STYL3R_SHARED", beside)) / "teachers" / name / "check.npz"
    with np.load(path) as archive:
        return {key: archive[key] for key in archive.files}


def test_psnr_by_hand() -> None:
    a = np.full((8, 8, 3), 0.5)
    assert psnr(a, a + 0.1) == pytest.approx(20)
    assert psnr(a, a) == 100
    assert psnr(a + 3, np.ones_like(a)) == 100  # what is too bright is clipped, as on a screen


def test_ssim_is_the_published_formula() -> None:
    a, b = picture(0), picture(1) * 0.5 + picture(0) * 0.5
    values = []
    for channel in range(3):
        x, y = a[..., channel], b[..., channel]

        def mean(z: Array) -> Array:
            return gaussian_filter(z, 1.5, truncate=3.5, mode="nearest")

        unbiased = 121 / 120
        var_x, var_y = (unbiased * (mean(z * z) - mean(z) ** 2) for z in (x, y))
        covariance = unbiased * (mean(x * y) - mean(x) * mean(y))
        top = (2 * mean(x) * mean(y) + 1e-4) * (2 * covariance + 9e-4)
        low = (mean(x) ** 2 + mean(y) ** 2 + 1e-4) * (var_x + var_y + 9e-4)
        values.append((top / low)[5:-5, 5:-5].mean())
    assert ssim(a, b) == pytest.approx(np.mean(values), abs=1e-9)
    assert ssim(a, a) == pytest.approx(1)


def test_edges_ignore_colour_but_not_shape() -> None:
    grey = np.repeat(picture(2)[..., :1], 3, axis=2)
    tinted = grey + np.array([0.299, 0.299, -0.299 * (0.299 + 0.587) / 0.114]) * 0.02
    assert edge_ssim(grey, tinted) > 0.99
    assert edge_ssim(grey, grey[::-1]) < 0.5


def test_histograms_see_colours_and_neither_place_nor_brightness() -> None:
    one = np.random.default_rng(0).random((30, 20, 3))
    moved = one[::-1, ::-1]
    assert histogram(one).sum() == pytest.approx(1, abs=1e-5)
    assert histogram_distance(histogram(one), histogram(moved)) == pytest.approx(0, abs=1e-9)
    assert histogram_distance(histogram(one), histogram(one * 0.5)) < 0.01
    red, blue = np.zeros((9, 9, 3)), np.zeros((9, 9, 3))
    red[..., 0], blue[..., 2] = 1, 1
    assert histogram_distance(histogram(red), histogram(blue)) > 0.7


@given(st.tuples(*[st.floats(-2, 2)] * 3), st.floats(0.1, 10), st.tuples(*[st.floats(-5, 5)] * 3))
@settings(max_examples=30, deadline=None)
def test_alignment_finds_the_similarity(
    turn: tuple[float, ...], scale: float, shift: tuple[float, ...]
) -> None:
    world = Similarity(Rotation.from_rotvec(turn).as_matrix(), scale, np.array(shift))
    true = cameras(64)
    found = align([true[0], true[2]], [world.camera(true[0]), world.camera(true[2])])
    expected, middle = world.camera(true[1]), found.camera(true[1])
    np.testing.assert_allclose(middle.extrinsics, expected.extrinsics, atol=1e-9)


def test_a_perfect_model_in_a_world_of_its_own() -> None:
    group = plane_group(96)
    prediction, gaussians = perfect_prediction(group, WORLD)
    values = novel_view_values(group, prediction, gaussians, "true", None, 1)
    (model,), (photo,) = (
        values["novel view", "PSNR (dB)", method] for method in ("model", "nearest photo")
    )
    assert model > 26
    assert model > photo + 8
    depth = depth_values(group, prediction.scene.means, prediction.recovered.cameras)
    assert depth["depth", "AbsRel, one scale", "model"][0] < 2e-3
    poses = camera_values(group, prediction.recovered, prediction.given, 100.0)
    assert poses["cameras", "larger of both (deg)", "model"][0] < 1e-5


def test_a_plane_is_what_homographies_are_made_for() -> None:
    source, target, _ = plane_group(96).scene.views
    inner = np.s_[24:-24, 24:-24]  # without the margin that the source does not show
    warped, truth, unmoved = (
        p[inner] / 255 for p in (warp(source, target), target.pixels, source.pixels)
    )
    assert psnr(warped, truth) > 35
    assert psnr(unmoved, truth) < 20


def test_a_wrong_camera_costs() -> None:
    group = plane_group(96)
    prediction, gaussians = perfect_prediction(group, WORLD)
    right = novel_view_values(group, prediction, gaussians, "true", None, 1)
    lying = prediction.recovered.cameras
    lying[1] = lying[0]
    wrong = novel_view_values(group, prediction, gaussians, "true", None, 1)
    key = ("novel view", "PSNR (dB)", "model")
    assert wrong[key][0] < right[key][0] - 5


def test_a_slightly_wrong_pose_can_be_adjusted() -> None:
    group = plane_group(48)
    prediction, gaussians = perfect_prediction(group, WORLD)
    right = prediction.recovered.cameras[0]
    nudge = np.eye(4)
    nudge[:3, :3] = Rotation.from_rotvec([0.01, 0.02, -0.01]).as_matrix()
    nudge[:3, 3] = [0.02 * WORLD.scale, 0, 0]
    wrong = replace(right, extrinsics=nudge @ right.extrinsics)
    photo = group.views[0].pixels / np.float32(255)
    unit = 0.6 * WORLD.scale  # between the outer cameras
    fitted = adjust_pose(gaussians, wrong, photo, unit, 30, 1)
    before, after, best = (
        psnr(render(gaussians, camera, threads=1).colour, photo)
        for camera in (wrong, fitted, right)
    )
    assert before < best - 4
    assert after > best - 1
    np.testing.assert_allclose(np.linalg.det(fitted.extrinsics[:3, :3]), 1, atol=1e-5)


@pytest.mark.parametrize("shift", [(3, 0), (0, -4), (2, 5)])
def test_whole_pixel_flow_moves_pixels(shift: tuple[int, int]) -> None:
    frame, flow = picture(3), np.broadcast_to(np.float32(shift), (40, 40, 2))
    moved, cover = splat(frame, flow, np.zeros((40, 40)))
    inside = cover > 0
    expected = np.roll(frame, shift[::-1], axis=(0, 1))
    np.testing.assert_allclose(moved[inside], expected[inside], atol=1e-12)
    assert inside.sum() == (40 - abs(shift[0])) * (40 - abs(shift[1]))
    assert np.unique(cover).tolist() == [0, 1]


def test_where_pixels_meet_the_important_one_is_seen() -> None:
    frame, flow = np.zeros((5, 5, 1)), np.zeros((5, 5, 2), np.float32)
    frame[2, 3] = 1
    flow[2, 3] = (-1, 0)  # onto its left neighbour
    importance = np.zeros((5, 5))
    for rank, expected in ((30, 1.0), (-30, 0.0), (0, 0.5)):
        importance[2, 3] = rank
        moved, cover = splat(frame, flow, importance)
        assert moved[2, 2, 0] == pytest.approx(expected)
        assert cover[2, 2] == 2
        assert cover[2, 3] == 0


@given(st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_a_flat_picture_stays_flat(seed: int) -> None:
    rng = np.random.default_rng(seed)
    flow = rng.normal(scale=3, size=(12, 12, 2)).astype(np.float32)
    moved, cover = splat(np.full((12, 12, 2), 0.7), flow, rng.normal(size=(12, 12)))
    np.testing.assert_allclose(moved[cover > 0], 0.7)
    assert cover.sum() <= 144 + 1e-6


def test_lpips_and_flow_agree_with_their_published_weights() -> None:
    lpips = check_or_skip("lpips")
    a, b = (lpips[f"image{k}"][0].transpose(1, 2, 0) for k in (0, 1))
    assert teachers().lpips(a, b) == pytest.approx(float(lpips["lpips_alex"]), abs=1e-6)
    raft = check_or_skip("raft-small")
    pair = np.stack([raft["image1"], raft["image2"]]).transpose(0, 3, 1, 2) / np.float32(127.5) - 1
    with torch.inference_mode():
        flow = teachers().flow.coarse_flow(torch.from_numpy(pair)).numpy()
    np.testing.assert_allclose(flow, raft["flow_eighth_12iters"], atol=1e-4)


def check_or_skip(name: str) -> dict[str, NDArray[np.float32]]:
    teachers()
    return check_file(name)


def test_stylizers_agree_with_their_published_weights() -> None:
    known = check_or_skip("micro-ast")
    content, style, expected = (
        known[name][0].transpose(1, 2, 0) for name in ("content", "style", "stylized")
    )
    made = teachers().stylizers["MicroAST"](content, style)
    np.testing.assert_allclose(made, expected.clip(0, 1), atol=3e-3)  # its weights are halved


def painting(seed: int) -> Painting:
    colours = picture(seed, 128) * [1, 0.6, 0.2]
    return Painting("p", colours, features(teachers().vgg, colours), histogram(colours))


def test_the_painting_itself_has_its_style_and_the_photo_its_content() -> None:
    style, photo, vgg = painting(5), picture(6, 64), teachers().vgg
    copy = compare_style(style.picture, style.features, style)
    assert copy["style", "mean/std distance"] == pytest.approx(0, abs=1e-9)
    assert copy["style", "RGB-uv histogram distance"] == pytest.approx(0, abs=1e-9)
    original = features(vgg, photo)
    same = compare_content(photo, original, photo, original)
    assert same["content", "perceptual distance"] == pytest.approx(0, abs=1e-9)
    assert same["content", "SSIM of edges"] == pytest.approx(1)
    made = teachers().stylizers["MicroAST"](photo, style.picture)
    plain, stylized = (compare_style(p, features(vgg, p), style) for p in (photo, made))
    for measure, distance in plain.items():
        assert stylized[measure] < 0.7 * distance


def test_what_is_painted_on_the_scene_is_more_consistent_than_frames() -> None:
    group = plane_group(128)
    prediction, own = perfect_prediction(group, WORLD)
    stylized = own.with_colours((1 - own.colours) ** 2)  # another colour, but one for each place
    photos = tuple(group.views[k].pixels / np.float32(255) for k in (0, len(group.inputs) - 1))
    values = consistency_values(
        own, stylized, prediction.recovered.cameras, painting(7), teachers(), 1, photos
    )
    for measure in ("short RMSE", "short LPIPS", "long RMSE", "long LPIPS", "whole RMSE"):
        model, frames = (np.mean(values["consistency", measure, m]) for m in ("model", "MicroAST"))
        assert model < 0.6 * frames
    assert np.mean(values["consistency", "short RMSE", "own colours"]) < 0.02
    # A perfect scene is charged with what the world itself is.
    world, model = (values["consistency", "whole RMSE", m] for m in ("the photos", "own colours"))
    assert len(world) == 1
    assert world == pytest.approx(model, rel=0.25)


def test_camera_paths_pass_through_the_inputs() -> None:
    stops = cameras(64)
    path = camera_path(stops, 9)
    for k, stop in ((0, 0), (4, 1), (8, 2)):
        np.testing.assert_allclose(path[k].extrinsics, stops[stop].extrinsics, atol=1e-9)


def test_styles_are_the_ones_that_training_leaves_alone(tmp_path: Path) -> None:
    for k in range(23):
        (tmp_path / f"{k:02d}.jpg").write_bytes(b"")
    (tmp_path / "SOURCES.csv").write_text("")
    styles = held_out_styles(tmp_path)
    assert [path.name for path in styles] == ["00.jpg", "10.jpg", "20.jpg"]
    chosen = [choose_style(styles, "fern", number).name for number in range(3)]
    assert sorted(chosen) == ["00.jpg", "10.jpg", "20.jpg"]
