"""The shipped examples: sizes a repository can carry, EXIF, and that the code makes them."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from styl3r_export.scenes.examples.__main__ import STYLES, jpeg
from styl3r_export.scenes.examples.brush import Canvas, along, trace
from styl3r_export.scenes.examples.still_life import curve

EXAMPLES = Path(__file__).parents[2] / "examples"
PHOTOS = [EXAMPLES / "room" / f"photo_{k}.jpg" for k in range(1, 5)]


def test_photos_look_like_a_phones() -> None:
    assert sum(p.stat().st_size for p in PHOTOS) < 600_000
    for path in PHOTOS:
        with Image.open(path) as photo:
            assert photo.size == (640, 480)
            assert photo.getexif().get_ifd(0x8769)[0xA405] == 28


def test_photos_show_one_scene_from_different_places() -> None:
    """Features of neighbouring photos match under one fundamental matrix, and have moved."""
    grey = [cv2.imread(str(p), cv2.IMREAD_GRAYSCALE) for p in PHOTOS[:2]]
    found = [cv2.SIFT_create(800).detectAndCompute(g, None) for g in grey]
    pairs = cv2.BFMatcher().knnMatch(found[0][1], found[1][1], k=2)
    good = [a for a, b in pairs if a.distance < 0.75 * b.distance]
    points = [
        np.float32([found[0][0][m.queryIdx].pt for m in good]),
        np.float32([found[1][0][m.trainIdx].pt for m in good]),
    ]
    _, inliers = cv2.findFundamentalMat(*points, cv2.FM_RANSAC, 1.5)
    assert inliers.sum() > 80
    assert inliers.mean() > 0.7
    assert np.median(np.linalg.norm(points[0] - points[1], axis=1)) > 8


@pytest.mark.parametrize("name", sorted(STYLES))
def test_styles_are_small_files_with_texture(name: str) -> None:
    path = EXAMPLES / "styles" / f"{name}.jpg"
    assert path.stat().st_size < 120_000
    picture = np.asarray(Image.open(path).convert("RGB"), np.float32)
    assert min(picture.shape[:2]) >= 256
    fine = picture.mean(-1) - cv2.GaussianBlur(picture.mean(-1), (0, 0), 3)
    assert fine.std() > 4  # strokes, dots, stones: something to transfer


def test_a_stroke_lies_along_its_path() -> None:
    canvas = Canvas(80, 120, (1.0, 1.0, 1.0))
    path = np.stack([np.linspace(20, 100, 17), np.full(17, 40.0)], 1)
    canvas.stroke(path, 14.0, np.float32([0.8, 0.1, 0.1]), np.random.default_rng(0))
    painted = canvas.colour[..., 1] < 128
    rows, columns = np.nonzero(painted)
    assert painted[40, 40:80].mean() > 0.9
    assert rows.min() >= 30
    assert rows.max() <= 50
    assert columns.min() >= 14
    assert columns.max() <= 106


def test_strokes_follow_level_lines() -> None:
    y, x = np.mgrid[0:100, 0:100].astype(np.float32) - 50
    field = along(x, y)  # level lines of x^2 + y^2 are circles
    path = trace(field, np.array([80.0, 50.0]), 60.0, 2.0) - 50
    np.testing.assert_allclose(np.linalg.norm(path, axis=1), 30, atol=2.5)
    assert np.ptp(path[:, 1]) > 30


def test_curves_pass_through_their_knots() -> None:
    knots = [(0.0, 0.0), (1.0, 2.0), (3.0, 1.0)]
    np.testing.assert_allclose(curve(knots, 5)[[0, 2, 4]], knots, atol=1e-6)


def test_jpeg_keeps_to_its_size() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (200, 200, 3), np.uint8)
    assert len(jpeg(noise, 10**6)) > len(jpeg(noise, 1))


@pytest.mark.slow
def test_the_wave_is_what_the_code_paints() -> None:
    shipped = np.asarray(Image.open(EXAMPLES / "styles" / "wave.jpg").convert("RGB"), np.float32)
    assert np.abs(STYLES["wave"]().astype(np.float32) - shipped).mean() < 6
