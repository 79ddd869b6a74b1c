"""A step of shapes: its slopes are what small changes do, and it comes nearer to what is wanted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.fitting.refit import GREY, Target, squared_errors
from styl3r_cli.fitting.reshape import OPACITY, SCALE, UNKNOWNS, VEIL, VEIL_WEIGHT, Slopes, reshape
from styl3r_cli.fitting.tracing import Trace, look
from styl3r_cli.gaussians import FloatArray, Gaussians

STEP = 1e-2  # large enough for float32, small enough for straight lines


def shrunk(scene: Gaussians, size: float, opacity: float) -> Gaussians:
    return replace(
        scene,
        scales=scene.scales * np.float32(size),
        opacities=scene.opacities * np.float32(opacity),
    )


def on_grey(seen: Trace) -> FloatArray:
    return seen.picture + (GREY * seen.through)[:, None]


@pytest.mark.parametrize("unknown", [OPACITY, SCALE])
def test_slopes_are_what_small_changes_do(
    scene: Gaussians, cameras: list[Camera], unknown: int
) -> None:
    scene = shrunk(scene, 1, 0.6)  # no alpha at its ceiling
    before = look(scene, cameras[:1], 1)[0]
    # Splats of many pixels are their Gaussians' own; of these all are taken to be.
    slopes = Slopes.of(before, scene.colours, scene.opacities, np.ones(len(scene), np.float32))
    values = np.zeros((len(scene), UNKNOWNS), np.float32)
    values[:, unknown] = STEP
    told = slopes.draw(values)
    factor = float(np.exp(STEP))
    more = shrunk(scene, *((1, factor) if unknown == OPACITY else (factor, 1)))
    after = look(more, cameras[:1], 1)[0]
    found = on_grey(after) - on_grey(before)
    assert np.abs(found).max() > 1e-3
    likeness = np.corrcoef(told[:, :VEIL].ravel(), found.ravel())[0, 1]
    assert likeness > (0.99 if unknown == OPACITY else 0.8)  # dilation is not the Gaussians' own
    if unknown == OPACITY:
        veil = VEIL_WEIGHT * (after.through - before.through)
        assert np.corrcoef(told[:, VEIL], veil)[0, 1] > 0.99


def test_gathering_is_the_transpose_of_drawing(scene: Gaussians, cameras: list[Camera]) -> None:
    seen = look(scene, cameras[:1], 1)[0]
    slopes = Slopes.of(seen, scene.colours, scene.opacities, np.ones(len(scene), np.float32))
    random = np.random.default_rng(4)
    unknowns = random.standard_normal((len(scene), UNKNOWNS)).astype(np.float32)
    pixels = random.standard_normal((len(seen.picture), VEIL + 1)).astype(np.float32)
    one = np.vdot(slopes.draw(unknowns).astype(np.float64), pixels)
    assert one == pytest.approx(
        np.vdot(unknowns, slopes.gather(pixels).astype(np.float64)), rel=1e-3
    )


@pytest.mark.parametrize("unit", [1e-30, 1e30])
def test_a_step_is_the_same_in_any_unit_of_length(
    scene: Gaussians, cameras: list[Camera], unit: float
) -> None:
    """Squares of lengths would not fit into float32."""
    wrong = shrunk(scene, 0.9, 0.85)
    sizes = np.full(len(scene), 1e-3)
    targets = [Target.of(each) for each in look(scene, cameras[:1], 1)]
    seen = look(wrong, cameras[:1], 1)
    larger = replace(wrong, scales=wrong.scales * np.float32(unit))
    plain = reshape(wrong, seen, targets, sizes, 2, 1)
    scaled = reshape(larger, seen, targets, sizes * unit, 2, 1)
    np.testing.assert_allclose(scaled.opacities, plain.opacities, rtol=1e-4)
    np.testing.assert_allclose(scaled.scales / np.float32(unit), plain.scales, rtol=1e-4)


def test_the_largest_scales_stay_finite(scene: Gaussians, cameras: list[Camera]) -> None:
    wrong = shrunk(scene, 0.9, 0.85)
    targets = [Target.of(each) for each in look(scene, cameras[:1], 1)]
    unit = 3.4e38 / float(wrong.scales.max())
    largest = replace(wrong, scales=(wrong.scales * np.float64(unit)).astype(np.float32))
    sizes = np.full(len(scene), 1e-3 * unit)
    made = reshape(largest, look(wrong, cameras[:1], 1), targets, sizes, 6, 1)
    assert np.isfinite(made.scales).all()
    assert made.scales.max() > 1e38


def test_a_step_comes_nearer(scene: Gaussians, cameras: list[Camera]) -> None:
    targets = [Target.of(each) for each in look(scene, cameras, 1)]
    wrong = shrunk(scene, 0.9, 0.85)

    def error(gaussians: Gaussians) -> float:
        seen = look(gaussians, cameras, 1)
        pairs = zip(targets, seen, strict=True)
        return float(np.mean([squared_errors(t, s.picture, s.through).mean() for t, s in pairs]))

    sizes = np.full(len(scene), 1e-3)
    made = [reshape(wrong, look(wrong, cameras, 1), targets, sizes, 6, n) for n in (1, 3)]
    assert error(made[0]) < 0.3 * error(wrong)
    assert (made[0].scales == made[1].scales).all()
    assert (made[0].opacities == made[1].opacities).all()
    assert (made[0].means == wrong.means).all()
