"""The evaluation on a scene whose truth the tiny model knows, and its parts against references."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation
from striped_scene import FOCAL, SIDE, write_scene

from styl3r_cli.cameras.depth_errors import relative_errors
from styl3r_cli.cameras.pose_errors import direction_error, rotation_error
from styl3r_cli.cameras.two_view import features, match, solve
from styl3r_cli.photos.resize import fit_photo
from styl3r_export.cropping import crop_camera
from styl3r_export.evaluate.__main__ import main
from styl3r_export.evaluate.depth import fit_plane
from styl3r_export.evaluate.groups import choose_groups
from styl3r_export.evaluate.poses import area_under_recall
from styl3r_export.evaluate.scenes import load_scene


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("scenes")
    write_scene(root / "stripes")
    write_scene(root / "box_shelf", photos=3)
    return root


def run(scenes: Path, model: Path, *options: str) -> tuple[str, dict[tuple[str, ...], float]]:
    """The printed table, and all medians by kind, views, what, measure and method."""
    output = scenes / "numbers.json"
    arguments = [str(model), "--scenes", str(scenes), "--size", str(SIDE), "--json", str(output)]
    result = CliRunner().invoke(main, [*arguments, *options], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    numbers = json.loads(output.read_text())
    keys = ("kind", "views", "what", "measure", "method")
    return result.stdout, {tuple(s[k] for k in keys): s["median"] for s in numbers["summaries"]}


def test_a_model_that_is_right_gets_full_marks(scenes: Path, tiny_model: Path) -> None:
    text, medians = run(scenes, tiny_model, "--rows", "depth,cameras")
    for views in (2, 4):
        depth = {k[3:]: v for k, v in medians.items() if k[:3] == ("validation", views, "depth")}
        assert depth["AbsRel, one scale", "model"] < 0.004  # depth varies within a pixel
        assert depth["delta<1.25, one scale", "model"] == 1
        assert depth["AbsRel, one scale", "constant"] > 0.05
        assert depth["AbsRel, one scale", "plane (oracle)"] > 0.02
        poses = {k[3:]: v for k, v in medians.items() if k[:3] == ("validation", views, "cameras")}
        assert poses["rotation (deg)", "model"] < 0.05
        assert poses["direction (deg)", "model"] < 0.5
        assert poses["focal length (relative)", "model"] < 1e-3
        # Nothing moves along stripes, so the classical way has nothing to go by.
        assert poses["direction (deg)", "SIFT + E"] == 90
        assert poses["rotation (deg)", "identity"] == pytest.approx(0, abs=1e-5)
    assert "validation scenes, 2 views: 1 scenes" in text
    assert "training scenes, 2 views: 1 scenes" in text
    assert "training scenes, 4 views" not in text  # three photos only


def test_an_assumed_focal_length_is_measured(scenes: Path, tiny_model: Path) -> None:
    _, medians = run(scenes, tiny_model, "--rows", "cameras", "--intrinsics", "assumed")
    model = medians["validation", 2, "cameras", "focal length (relative)", "model"]
    # The tiny model believes what it is told: 28 mm equivalent across the square photo.
    assumed = 28 * np.hypot(SIDE, SIDE) / np.hypot(36, 24)
    assert model == pytest.approx(abs(assumed / FOCAL - 1), rel=1e-3)


def test_the_same_command_gives_the_same_bytes(scenes: Path, tiny_model: Path) -> None:
    run(scenes, tiny_model, "--rows", "depth,cameras", "--views", "2")
    first = (scenes / "numbers.json").read_bytes()
    run(scenes, tiny_model, "--rows", "depth,cameras", "--views", "2")
    assert (scenes / "numbers.json").read_bytes() == first


def test_mistakes_get_one_line(scenes: Path, tiny_model: Path, tmp_path: Path) -> None:
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "cameras.json").write_text("{}")
    for arguments, code in (
        ([str(tiny_model), "--scenes", str(tmp_path)], 3),
        ([str(tmp_path / "none"), "--scenes", str(scenes)], 4),
        ([str(tiny_model), "--scenes", str(scenes), "--rows", "beauty"], 2),
        ([str(tiny_model), "--scenes", str(scenes), "--rows", "style"], 2),
        ([str(tiny_model), "--scenes", str(scenes), "--size", "100"], 2),
        ([str(tiny_model), "--scenes", str(scenes), "--only", "atlantis"], 2),
    ):
        result = CliRunner().invoke(main, arguments)
        assert result.exit_code == code, result.output
        assert "Error" in result.stderr
        assert "Traceback" not in result.stderr


def test_groups_are_neighbours_and_targets_lie_between(scenes: Path) -> None:
    scene = load_scene(scenes / "stripes", SIDE)
    pairs = choose_groups(scene, 2, 6)
    assert len(pairs) == 6
    assert len({pair.inputs for pair in pairs}) == 6
    assert any(pair.targets for pair in pairs)
    assert all(p.inputs[0] < target < p.inputs[1] for p in pairs for target in p.targets)
    fours = choose_groups(scene, 4, 6)
    assert {(g.inputs, g.targets) for g in fours} == {
        ((0, 1, 2, 3), ()), ((1, 2, 3, 4), ()), ((0, 1, 3, 4), (2,)),
    }  # fmt: skip
    assert len(choose_groups(scene, 2, 1)) == 1
    assert choose_groups(scene, 8, 4) == []


@pytest.mark.parametrize("shape", [(97, 60), (60, 97), (64, 64), (131, 128)])
def test_cropped_cameras_see_what_the_crop_shows(shape: tuple[int, int]) -> None:
    """A dot on the photo appears where the cropped camera projects it."""
    width, height = shape
    at = np.array([width * 0.47, height * 0.55])
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    dot = 255 * np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2 * 4**2))
    picture = Image.fromarray(np.repeat(dot[..., None], 3, axis=2).astype(np.uint8))
    fact = {"fx": 80.0, "fy": 80.0, "cx": at[0], "cy": at[1], "width": width, "height": height}
    camera, zoom, corner = crop_camera(fact | {"w2c": np.eye(4).tolist()}, shape, 48)
    crop = fit_photo(picture, (48, 48))[..., 0].astype(np.float64)
    u, v = np.meshgrid(np.arange(48) + 0.5, np.arange(48) + 0.5)
    found = np.array([(u * crop).sum(), (v * crop).sum()]) / crop.sum()
    np.testing.assert_allclose(found, [camera.cx, camera.cy], atol=0.05)
    np.testing.assert_allclose(at * zoom - corner, [camera.cx, camera.cy])


@given(st.lists(st.floats(0.01, 60), min_size=1, max_size=20), st.sampled_from([5.0, 10.0, 20.0]))
@settings(max_examples=50, deadline=None)
def test_area_under_recall_is_near_the_mean_recall(errors: list[float], limit: float) -> None:
    """Recall that rises linearly differs from the staircase by at most one error's share."""
    thresholds = (np.arange(4000) + 0.5) / 4000 * limit
    staircase = np.mean(np.array(errors)[:, None] <= thresholds)
    area = area_under_recall(errors, limit)
    assert abs(area - staircase) <= 1 / len(errors) + 1e-3
    assert 0 <= area <= 1


def test_area_under_recall_by_hand() -> None:
    assert area_under_recall([0.0, 0.0], 5) == pytest.approx(1)
    assert area_under_recall([30.0], 20) == 0
    # From (0, 0) to (5, 1/2), then flat to 10: 5 * 0.25 + 5 * 0.5.
    assert area_under_recall([5.0, 40.0], 10) == pytest.approx(0.375)


@pytest.mark.parametrize("outliers", [0.0, 0.3])
def test_the_essential_matrix_finds_the_pose(outliers: float) -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform([-2, -2, 3], [2, 2, 8], (200, 3))
    truth = np.eye(4)
    truth[:3, :3] = Rotation.from_rotvec([0.05, -0.2, 0.1]).as_matrix()
    truth[:3, 3] = [-0.6, 0.1, 0.2]
    first_k = np.array([[300, 0, 128], [0, 310, 120], [0, 0, 1.0]])
    second_k = np.array([[250, 0, 130], [0, 250, 128], [0, 0, 1.0]])
    a, b = points @ first_k.T, (points @ truth[:3, :3].T + truth[:3, 3]) @ second_k.T
    a, b = a[:, :2] / a[:, 2:], b[:, :2] / b[:, 2:]
    wild = rng.random(len(b)) < outliers
    b[wild] = rng.uniform(0, 256, (int(wild.sum()), 2))
    found = solve(a, b, first_k, second_k)
    assert found is not None
    assert rotation_error(found, truth) < 0.2
    assert direction_error(found, truth) < 1
    assert solve(a[:4], b[:4], first_k, second_k) is None


def test_sift_finds_the_shift_of_a_picture() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (20, 20, 3), dtype=np.uint8)
    wide = np.asarray(Image.fromarray(noise).resize((160, 160), Image.Resampling.BICUBIC))
    a, b = match(features(wide[:128, :128]), features(wide[5:133, 9:137]))
    assert len(a) > 20
    np.testing.assert_allclose(np.median(a - b, axis=0), [9, 5], atol=0.1)


def test_the_oracle_plane_ignores_outliers_and_relative_errors_count_factors() -> None:
    uv = np.random.default_rng(1).uniform(0, 64, (200, 2))
    depth = np.exp(0.5 + uv @ [0.01, -0.02])
    wild = depth.copy()
    wild[:40] *= 8
    np.testing.assert_allclose(fit_plane(uv, wild), depth, rtol=1e-3)
    error, close = relative_errors(np.array([1.0, 2.6, 0.0]), np.array([1.0, 2.0, 4.0]))
    assert error == pytest.approx((0 + 0.3 + 1) / 3)
    assert close == pytest.approx(1 / 3)
