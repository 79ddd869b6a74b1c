"""Nerfstudio's camera paths: read as its viewer writes them, and written for both readers."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.camera_path import read_camera_path, read_cameras, write_camera_path
from styl3r_cli.errors import InputError


def camera(turn: tuple[float, float, float], centre: tuple[float, float, float]) -> Camera:
    extrinsics = np.eye(4)
    extrinsics[:3, :3] = Rotation.from_euler("xyz", turn, degrees=True).as_matrix().T
    extrinsics[:3, 3] = -extrinsics[:3, :3] @ np.array(centre)
    return Camera(extrinsics, 300.0, 310.0, 150.0, 90.0, 320, 180)


CAMERAS = [camera((5, 10, 0), (1, 2, 3)), camera((0, -20, 5), (0.5, 0, 0))]
# A camera at (1, 2, 3) that looks along -z with y up, as the viewer writes it.
ENTRY = {
    "camera_to_world": [1, 0, 0, 1, 0, 1, 0, 2, 0, 0, 1, 3, 0, 0, 0, 1],
    "fov": 90,
    "aspect": 1.5,
}


def content(**changes: Any) -> dict[str, Any]:
    whole = {
        "camera_type": "perspective",
        "render_height": 200,
        "render_width": 300,
        "camera_path": [ENTRY, ENTRY],
        "fps": 30,
        "seconds": 4,
        "is_cycle": True,
        "crop": None,
    }
    return whole | changes


def test_a_path_of_nerfstudios_viewer() -> None:
    file = read_camera_path(json.dumps(content()).encode())
    assert (len(file.cameras), file.fps, file.loop) == (2, 30, True)
    seen = file.cameras[0]
    assert (seen.width, seen.height, seen.cx, seen.cy) == (300, 200, 150, 100)
    assert seen.fx == pytest.approx(100)  # 90 degrees from top to bottom
    # What lies two units ahead, and one up, in OpenCV's axes.
    ahead_and_up = seen.extrinsics @ [1, 3, 1, 1]
    np.testing.assert_allclose(ahead_and_up, [0, -1, 2, 1], atol=1e-12)


def test_one_file_serves_both_readers(tmp_path: Path) -> None:
    path = tmp_path / "path.json"
    write_camera_path(path, CAMERAS, 24, loop=False)
    exact = read_cameras(path)
    assert (exact.fps, exact.loop) == (24, False)
    for before, after in zip(CAMERAS, exact.cameras, strict=True):
        np.testing.assert_allclose(after.extrinsics, before.extrinsics, atol=1e-12)
        assert after.intrinsics.tolist() == before.intrinsics.tolist()
    # A camera path knows one focal length, and no principal point.
    for before, after in zip(CAMERAS, read_camera_path(path).cameras, strict=True):
        np.testing.assert_allclose(after.extrinsics, before.extrinsics, atol=1e-12)
        assert (after.fx, after.fy) == pytest.approx((310, 310))
        assert (after.width, after.height) == (320, 180)
    written = json.loads(path.read_text())
    assert written["seconds"] == pytest.approx(2 / 24)
    assert written["camera_path"][0]["fov"] == pytest.approx(math.degrees(2 * math.atan(90 / 310)))
    assert len(written["camera_path"][0]["camera_to_world"]) == 16


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera_path": []}, "no frames"),
        ({"camera_path": [3]}, "frame 1: not an object"),
        ({"camera_path": [ENTRY | {"fov": 0}]}, "frame 1: 'fov'"),
        ({"camera_path": [ENTRY | {"fov": "wide"}]}, "'fov' is 'wide'"),
        ({"camera_path": [ENTRY | {"camera_to_world": [1, 2]}]}, "'camera_to_world' is not a 4x4"),
        ({"camera_path": [ENTRY | {"camera_to_world": [2.0] * 12 + [0, 0, 0, 1]}]}, "rigid"),
        ({"camera_type": "equirectangular"}, "only perspective"),
        ({"render_width": 0}, "'render_width'"),
        ({"fps": -1}, "'fps' is -1"),
    ],
)
def test_wrong_paths_say_what_is_wrong(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    path = tmp_path / "p.json"
    path.write_text(json.dumps(content(**changes)))
    with pytest.raises(InputError, match=words) as caught:
        read_cameras(path)
    assert str(caught.value).startswith(str(path))
