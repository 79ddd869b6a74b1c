"""Photos that were exposed differently agree where they show one surface."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from wavy_wall import wall

from styl3r_cli.gaussians import FloatArray
from styl3r_cli.harmony import harmonised
from styl3r_cli.overlaps import Overlaps

TINT = np.array([0.75, 0.9, 0.85], np.float32)  # of the second photo, which is darker


def grey_pictures(count: int) -> tuple[Overlaps, FloatArray]:
    """Views of a wall, and their photos in tones that leave room for lighter and darker ones."""
    scene, recovered = wall(count)
    return Overlaps(scene, recovered), 0.25 + 0.5 * scene.images.transpose(0, 2, 3, 1)


def apart(pictures: FloatArray, overlaps: Overlaps, view: int) -> float:
    """Root mean square of how coarse tones differ between a view and what others show of it."""
    target, share = overlaps.taken_over(pictures, view)
    difference = target - share[..., None] * pictures[view]
    coarse = np.asarray(cv2.GaussianBlur(difference, (0, 0), 12.0))
    return float(np.sqrt(np.mean(coarse[share > 0.5] ** 2)))


def test_photos_of_other_exposures_and_vignettes_agree_in_tone_and_keep_their_detail() -> None:
    overlaps, pictures = grey_pictures(3)
    side = pictures.shape[1]
    y, x = np.mgrid[:side, :side] / side - 0.5
    vignette = (1 - 0.3 * (x**2 + y**2))[..., None].astype(np.float32)
    pictures[1] *= TINT * vignette
    pictures[2] *= 1.1
    made = harmonised(pictures, overlaps)
    for view in (0, 2):  # the middle one is who the others follow
        assert apart(made, overlaps, view) < 0.2 * apart(pictures, overlaps, view)
        fine = [each[view] - cv2.GaussianBlur(each[view], (0, 0), 2.0) for each in (made, pictures)]
        np.testing.assert_allclose(fine[0], fine[1], atol=0.01)


def test_the_views_stay_as_light_as_they_were_on_average() -> None:
    overlaps, pictures = grey_pictures(2)
    pictures[1] *= TINT
    made = harmonised(pictures, overlaps)
    for each in (made, pictures):
        assert each.min() > 0.1  # nothing was cut off
        assert each.max() < 0.9
    np.testing.assert_allclose(made.mean((0, 1, 2)), pictures.mean((0, 1, 2)), atol=1e-4)


@pytest.mark.parametrize("shift", [0.0, 0.05, -0.12])
def test_a_constant_difference_is_shared_out_and_none_changes_nothing(shift: float) -> None:
    overlaps, pictures = grey_pictures(2)
    flat = np.full_like(pictures, 0.5)
    flat[1] += shift
    made = harmonised(flat, overlaps)
    seen = overlaps.taken_over(made, 1)[1] > 0.5
    assert np.ptp(made[0]) < 1e-6
    np.testing.assert_allclose(made[1][seen], made[0][0, 0, 0], atol=abs(shift) / 5)
    if not shift:
        np.testing.assert_array_equal(made, flat)


def test_views_that_share_nothing_stay_to_the_byte() -> None:
    scene, recovered = wall(2)
    scene.means[1] += 100
    pictures = scene.images.transpose(0, 2, 3, 1).clip(0, 1)
    np.testing.assert_array_equal(harmonised(pictures, Overlaps(scene, recovered)), pictures)


def test_views_without_a_camera_or_a_visible_gaussian_change_no_other() -> None:
    scene, recovered = wall(2)
    pictures = 0.25 + 0.5 * scene.images.transpose(0, 2, 3, 1)
    pictures[1] *= TINT
    recovered.recovered[1] = False
    np.testing.assert_array_equal(harmonised(pictures, Overlaps(scene, recovered)), pictures)
    recovered.recovered[1] = True
    scene.opacities[1] = 0
    made = harmonised(pictures, Overlaps(scene, recovered))
    np.testing.assert_array_equal(made[0], pictures[0])
