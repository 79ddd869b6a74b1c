"""Encode once, colour many times: strengths, weights and repairs, against closed forms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tiny_model import BASELINE, write_model

from styl3r_cli.errors import ModelError, UsageError
from styl3r_cli.photos import Photos, load_photos
from styl3r_cli.pipeline import Scene, Stylizer, assemble

# The styles' weighted mean colour, and no input for the photos.
ONE_COLOUR_GRAPH = """
<ir_version: 10, opset_import: ["" : 18]>
appearance (float[N,L,3] content_tokens, float[S,3,h,w] style_images, float[S] style_weights)
  => (float[1,1,1,3] colours)
{
  area = Constant <value_ints = [2, 3]> ()
  means = ReduceMean <keepdims = 0> (style_images, area)
  column = Constant <value_ints = [1]> ()
  weights = Unsqueeze (style_weights, column)
  weighted = Mul (means, weights)
  first = Constant <value_ints = [0]> ()
  blended = ReduceSum <keepdims = 0> (weighted, first)
  shape = Constant <value_ints = [1, 1, 1, 3]> ()
  colours = Reshape (blended, shape)
}
"""
RED = np.broadcast_to(np.array([1, 0, 0], np.float32)[:, None, None], (3, 256, 256))
BLUE = RED[::-1]


@pytest.fixture(scope="module")
def stylizer(tiny_model: Path) -> Stylizer:
    return Stylizer(str(tiny_model), "cpu", threads=1)


@pytest.fixture(scope="module")
def views(make_picture: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Photos:
    folder = tmp_path_factory.mktemp("views")
    paths = [make_picture(folder / f"{index}.png", seed=index) for index in range(3)]
    return load_photos(paths, size=(48, 64), fov=60)


@pytest.fixture(scope="module")
def scene(stylizer: Stylizer, views: Photos) -> Scene:
    return stylizer.encode(views)


def test_geometry_is_what_the_graph_says(scene: Scene, views: Photos) -> None:
    assert scene.means.shape == (3, 48, 64, 3)
    depth = 2 + views.images.mean(axis=1)
    np.testing.assert_allclose(scene.means[..., 2], depth, atol=1e-5)
    fx, cx = views.intrinsics[2, 0, 0], views.intrinsics[2, 0, 2]
    x = ((10.5 / 64) - cx) / fx * depth[2, 20, 10] + 2 * BASELINE
    assert scene.means[2, 20, 10, 0] == pytest.approx(x, abs=1e-5)


def test_full_strength_is_the_style_alone(stylizer: Stylizer, scene: Scene) -> None:
    expected = 0.5 * scene.images.transpose(0, 2, 3, 1) + 0.5 * np.array([1, 0, 0])
    np.testing.assert_allclose(stylizer.colours(scene, [RED]), expected, atol=1e-6)


def test_zero_strength_is_exactly_the_reconstruction(stylizer: Stylizer, scene: Scene) -> None:
    own = stylizer.colours(scene, strength=0)
    np.testing.assert_array_equal(stylizer.colours(scene, [RED, BLUE], strength=0), own)
    assert not np.array_equal(stylizer.colours(scene, [RED], strength=0.01), own)


def test_content_stands_in_as_its_first_photo_in_its_own_range(
    stylizer: Stylizer, scene: Scene
) -> None:
    own = stylizer.colours(scene, strength=0)
    photo = scene.images[0]
    mean = (own - 0.5 * scene.images.transpose(0, 2, 3, 1)).mean(axis=(0, 1, 2)) * 2
    square = photo[:, :, 8:56]  # the centre crop of 48x64
    np.testing.assert_allclose(mean, square.mean(axis=(1, 2)) * 2 - 1, atol=0.01)


@settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck))
@given(strength=st.floats(0, 1), red=st.floats(0.001, 1000), blue=st.floats(0, 1000))
def test_colours_are_the_weighted_mixture(
    stylizer: Stylizer, scene: Scene, strength: float, red: float, blue: float
) -> None:
    mixed = stylizer.colours(scene, [RED, BLUE], [red, blue], strength)
    own = stylizer.colours(scene, strength=0)
    share = red / (red + blue)
    style = stylizer.colours(scene, [RED]) * share + stylizer.colours(scene, [BLUE]) * (1 - share)
    np.testing.assert_allclose(mixed, strength * style + (1 - strength) * own, atol=1e-5)


def test_only_ratios_of_weights_matter(stylizer: Stylizer, scene: Scene) -> None:
    twice = stylizer.colours(scene, [RED, BLUE], [6, 2])
    np.testing.assert_array_equal(twice, stylizer.colours(scene, [RED, BLUE], [3, 1]))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"styles": [RED], "strength": 1.5}, "strength 1.5"),
        ({"styles": [RED], "strength": float("nan")}, "strength nan"),
        ({"styles": [RED], "weights": [-1]}, "from 0"),
        ({"styles": [RED], "weights": [float("nan")]}, "numbers"),
        ({"styles": [RED], "weights": [float("inf")]}, "numbers"),
        ({"styles": [RED, BLUE], "weights": [1e308, 1e308]}, "from 0 to 1e"),
        ({"styles": [RED, BLUE], "weights": [0, 0]}, "all style weights are 0"),
        ({"styles": [RED, BLUE], "weights": [1]}, "2 styles but 1 weights"),
        ({"styles": []}, "needs at least one style"),
    ],
)
def test_senseless_mixtures_are_refused(
    stylizer: Stylizer, scene: Scene, arguments: dict, message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        stylizer.colours(scene, **arguments)


def test_graphs_that_do_not_read_the_photos(tmp_path: Path, views: Photos) -> None:
    model = Stylizer(str(write_model(tmp_path / "m", appearance=ONE_COLOUR_GRAPH)), "cpu")
    colours = model.colours(model.encode(views), [RED, BLUE], [3, 1])
    np.testing.assert_allclose(colours, np.array([0.75, 0, 0.25]).reshape(1, 1, 1, 3))


def test_repairs_are_made_and_counted(scene: Scene) -> None:
    means, scales = scene.means.copy(), scene.scales.copy()
    rotations, opacities = scene.rotations.copy(), scene.opacities.copy()
    colours = np.full_like(means, 0.5)
    means[0, 0, 0, 1] = np.nan
    scales[0, 0, 1, 2] = np.inf
    colours[0, 0, 2, 0] = -np.inf
    rotations[0, 0, 3] = 0
    opacities[0, 0, 4] = np.nan
    opacities[0, 0, 5:7] = [-0.1, 1.1]
    scales[0, 0, 7] = 0
    rotations[0, 0, 8] = [2, 0, 0, 0]
    damaged = replace(scene, means=means, scales=scales, rotations=rotations, opacities=opacities)
    gaussians, repairs = assemble(damaged, colours)
    assert len(gaussians) == 3 * 48 * 64 - 5
    assert repairs.to_dict() == {
        "dropped_not_finite": 5,
        "clamped_opacities": 2,
        "floored_scales": 1,
        "normalised_rotations": 1,
    }
    assert str(repairs) == (
        "5 dropped not finite, 2 clamped opacities, 1 floored scales, 1 normalised rotations"
    )
    for array in (gaussians.means, gaussians.rotations, np.log(gaussians.scales)):
        assert np.isfinite(array).all()
    assert gaussians.opacities.min() == 0
    assert gaussians.opacities.max() == 1
    np.testing.assert_allclose(np.linalg.norm(gaussians.rotations, axis=1), 1, atol=1e-6)


def test_a_sound_scene_passes_unchanged(scene: Scene) -> None:
    gaussians, repairs = assemble(scene, np.full_like(scene.means, 0.5))
    assert not str(repairs)
    np.testing.assert_array_equal(gaussians.means, scene.means.reshape(-1, 3))
    np.testing.assert_array_equal(gaussians.opacities, scene.opacities.reshape(-1))


def test_nothing_finite_is_an_error(scene: Scene) -> None:
    with pytest.raises(ModelError, match="no finite Gaussian"):
        assemble(replace(scene, means=np.full_like(scene.means, np.nan)), scene.means)
