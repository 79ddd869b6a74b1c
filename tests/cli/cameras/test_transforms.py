"""Camera files: nerfstudio's axes and field names, round trips, and files that are wrong."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation

from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.photo_frames import cameras_of_photos, read_cameras_of
from styl3r_cli.cameras.transforms import read_transforms, write_transforms
from styl3r_cli.errors import InputError

SHARED = {"fl_x": 500.0, "fl_y": 510.0, "cx": 320.0, "cy": 200.0, "w": 640, "h": 400}
IDENTITY = np.eye(4).tolist()


def camera(turn: list[float], centre: list[float], fx: float = 300.0) -> Camera:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    pose[:3, 3] = -pose[:3, :3] @ centre
    return Camera(pose, fx, fx * 1.1, 130.5, 120.25, 256, 240)


def file(*frames: dict[str, Any], **shared: Any) -> bytes:
    return json.dumps({**SHARED, **shared, "frames": list(frames)}).encode()


def frame(matrix: Any = IDENTITY, **values: Any) -> dict[str, Any]:
    return {"file_path": "images/a.jpg", "transform_matrix": matrix, **values}


def test_written_file_has_nerfstudio_names_and_axes(tmp_path: Path) -> None:
    """nerfstudio: camera-to-world, camera x right, y up, looking along its -z."""
    path = tmp_path / "transforms.json"
    seen = camera([0, math.pi / 2, 0], [1, 2, 3])
    write_transforms(path, [seen], ["images/é.jpg"])
    content = json.loads(path.read_text("utf-8"))
    assert content["camera_model"] == "OPENCV"
    (written,) = content["frames"]
    assert written["file_path"] == "images/é.jpg"
    assert [written[key] for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")] == [
        300.0,
        pytest.approx(330.0),
        130.5,
        120.25,
        256,
        240,
    ]
    matrix = np.array(written["transform_matrix"])
    np.testing.assert_allclose(matrix[:3, 3], [1, 2, 3], atol=1e-12)  # the camera's centre
    rotation = seen.extrinsics[:3, :3]
    np.testing.assert_allclose(-matrix[:3, 2], rotation[2], atol=1e-12)  # where it looks
    np.testing.assert_allclose(matrix[:3, 1], -rotation[1], atol=1e-12)  # up is not down
    np.testing.assert_allclose(matrix[:3, 0], rotation[0], atol=1e-12)


numbers = st.floats(-100, 100)


@given(st.lists(numbers, min_size=3, max_size=3), st.lists(numbers, min_size=3, max_size=3))
@settings(max_examples=50, deadline=None)
def test_round_trip(tmp_path_factory: Any, turn: list[float], centre: list[float]) -> None:
    path = tmp_path_factory.mktemp("a") / "transforms.json"
    before = [camera(turn, centre), camera([0.1, 0.2, 0.3], [0, 0, 0], 77.0)]
    write_transforms(path, before, ["a.jpg", "b.jpg"])
    after = read_transforms(path)
    assert after.file_paths == ["a.jpg", "b.jpg"]
    assert after.notes == []
    for one, two in zip(before, after.cameras, strict=True):
        np.testing.assert_allclose(one.extrinsics, two.extrinsics, atol=1e-11)
        assert (one.fx, one.fy, one.cx, one.cy) == (two.fx, two.fy, two.cx, two.cy)
        assert (one.width, one.height) == (two.width, two.height)


def test_the_same_cameras_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.json", "b.json"):
        write_transforms(tmp_path / name, [camera([0.1, 0, 0], [1, 0, 0])], ["x"])
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_intrinsics_of_the_frame_beat_those_of_the_file() -> None:
    cameras = read_transforms(file(frame(), frame(fl_x=700.0, w=800))).cameras
    assert (cameras[0].fx, cameras[0].width) == (500.0, 640)
    assert (cameras[1].fx, cameras[1].fy, cameras[1].width) == (700.0, 510.0, 800)


def test_an_angle_of_the_frame_beats_the_lens_of_the_file() -> None:
    cameras = read_transforms(file(frame(), frame(camera_angle_x=math.pi / 2))).cameras
    assert (cameras[0].fx, cameras[0].fy) == (500.0, 510.0)
    assert cameras[1].fx == cameras[1].fy == pytest.approx(320.0)
    (own,) = read_transforms(file(frame(camera_angle_x=1.0, fl_x=700.0))).cameras
    assert (own.fx, own.fy) == (700.0, 510.0)
    (both,) = read_transforms(file(frame(camera_angle_x=1.0, camera_angle_y=math.pi / 2))).cameras
    assert both.fy == pytest.approx(200.0)


def test_blender_and_ngp_files_with_an_angle() -> None:
    content = {"camera_angle_x": math.pi / 2, "frames": [frame()]}
    (found,) = read_transforms(json.dumps(content).encode(), size=(640, 400)).cameras
    assert found.fx == found.fy == pytest.approx(320.0)
    assert (found.cx, found.cy, found.width, found.height) == (320.0, 200.0, 640, 400)


def test_distortion_is_ignored_with_a_note() -> None:
    assert read_transforms(file(frame(), k1=0.0, p2=0)).notes == []
    (note,) = read_transforms(file(frame(k1=-0.1), frame())).notes
    assert "lens distortion in 1 frames is ignored" in note


def test_distortion_in_one_list_is_noted_as_well() -> None:
    """What nerfstudio reads before k1, k2, ..."""
    assert read_transforms(file(frame(), distortion_params=[0, 0.0, 0, 0])).notes == []
    (note,) = read_transforms(file(frame(), frame(), distortion_params=[0, 0.1, 0, 0])).notes
    assert "lens distortion in 2 frames is ignored" in note
    for odd in ({}, "x", [None, {}], 5):
        assert read_transforms(file(frame(), distortion_params=odd)).cameras


def test_lenses_that_a_file_says_it_has_not_are_no_reason_to_refuse_it() -> None:
    """Instant NGP writes `is_fisheye: false` beside every lens that is none."""
    (found,) = read_transforms(file(frame(), is_fisheye=False, latlong=None)).cameras
    assert found.fx == SHARED["fl_x"]


def test_three_rows_and_six_digits_are_enough() -> None:
    seen = camera([0.3, -0.2, 0.9], [1, 2, 3])
    rows = np.linalg.inv(seen.extrinsics) @ np.diag([1, -1, -1, 1])
    (found,) = read_transforms(file(frame(np.round(rows[:3], 6).tolist()))).cameras
    np.testing.assert_allclose(found.extrinsics, seen.extrinsics, atol=1e-5)
    rotation = found.extrinsics[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)


SCALED = np.diag([2.0, 2, 2, 1]).tolist()
SHEARED = [[1, 0.1, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
MIRRORED = np.diag([-1.0, 1, 1, 1]).tolist()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "not a JSON file"),
        (b"[1, 2]", "an object with 'frames'"),
        (b"{}", "no 'frames'"),
        (b'{"camera_path": []}', "a nerfstudio camera path"),
        (file(), "no 'frames'"),
        (file(frame(SCALED)), "frame 1: .* no rigid motion"),
        (file(frame(), frame(SHEARED)), "frame 2: .* no rigid motion"),
        (file(frame(MIRRORED)), "mirrors the scene"),
        (file(frame([[1, 2], [3, 4]])), "not a 4x4 matrix"),
        (file(frame("identity")), "not a 4x4 matrix"),
        (file({"file_path": "a.jpg"}), "not a 4x4 matrix"),
        (file(frame([["1.0", 0, 0, 0], *IDENTITY[1:]])), "not a 4x4 matrix of numbers"),
        (file(frame([[True, 0, 0, 0], *IDENTITY[1:]])), "not a 4x4 matrix of numbers"),
        (file(frame([*IDENTITY[:3], None])), "not a 4x4 matrix of numbers"),
        (file(frame([[float("nan")] * 4] * 4)), "not a 4x4 matrix"),
        (file(frame(np.ones((4, 4)).tolist())), "last row"),
        (file(frame(), fl_x="wide"), "'fl_x' is 'wide', not a number"),
        (file(frame(), fl_x=-5.0), "'fl_x' is -5, not a focal length"),
        (file(frame(), w=0), "not a picture's size"),
        (file(frame(), w=None), "no 'w' and 'h'"),
        (file(frame(), fl_x=None, fl_y=None), "no focal length"),
        (file(frame(), camera_model="OPENCV_FISHEYE"), "'OPENCV_FISHEYE' is no perspective camera"),
        (file(frame(), is_fisheye=True), "frame 1: 'is_fisheye' is no perspective camera"),
        (file(frame(), frame(latlong=True)), "frame 2: 'latlong' is no perspective camera"),
        (file(frame(), ftheta_p1=0.1), "'ftheta_p1' is no perspective camera"),
        (file(frame(), fl_x=None, fl_y=None, camera_angle_x=60), "'camera_angle_x' is 60, not"),
        (file(frame(), fl_x=None, camera_angle_x=-0.9), "'camera_angle_x' is -0.9, not"),
        (file("a.jpg"), "frame 1: not an object"),  # type: ignore[arg-type]
    ],
)
def test_wrong_files_say_what_is_wrong(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "t.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=rf"t\.json: .*{words}") as caught:
        read_transforms(path)
    assert "\n" not in str(caught.value)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_transforms(tmp_path / "gone.json")


def test_photos_find_their_cameras_by_name() -> None:
    paths = ["left/1.jpg", "right/1.jpg", "./images/2", "images\\3.jpg"]
    known = read_transforms(
        file(*[frame(file_path=path, fl_x=100.0 + i) for i, path in enumerate(paths)])
    )
    photos = [Path("in/right/1.jpg"), Path("2.png"), Path("3.jpg"), Path("4.jpg")]
    found, notes = cameras_of_photos(known, photos)
    assert {str(path): found[path].fx for path in found} == {
        "in/right/1.jpg": 101.0,
        "2.png": 102.0,
        "3.jpg": 103.0,
    }
    assert notes == ["the camera file: no camera for 4.jpg"]
    with pytest.raises(InputError, match=r"no frame's file_path is one of the photos \(9\.jpg"):
        cameras_of_photos(known, [Path("9.jpg")])


def test_frames_that_contradict_each_other_are_refused() -> None:
    far = np.eye(4)
    far[0, 3] = 1.0
    photo = Path("images/a.jpg")
    for other in (frame(fl_x=9e2), frame(far.tolist()), frame(depth_file_path="d.png")):
        with pytest.raises(InputError, match=r"^t: frames 1 and 2 are both of images/a\.jpg, and"):
            cameras_of_photos(read_transforms(file(frame(), other)), [photo], "t")
    (found,), notes = cameras_of_photos(read_transforms(file(frame(), frame())), [photo])
    assert (found, notes) == (photo, [])


def test_photos_of_one_name_need_frames_of_their_own() -> None:
    photos = [Path("left/1.jpg"), Path("right/1.jpg")]
    one = read_transforms(file(frame(file_path="1.jpg")))
    with pytest.raises(InputError, match=r"frame 1 may be of left/1\.jpg and of right/1\.jpg; "):
        cameras_of_photos(one, photos)
    assert len(cameras_of_photos(one, [photos[0], photos[0]])[0]) == 1
    left = read_transforms(file(frame(file_path="left/1.jpg")))
    found, notes = cameras_of_photos(left, photos)
    assert list(found) == photos[:1]
    assert notes == ["the camera file: no camera for right/1.jpg"]
    paths = [str(photo.absolute()) for photo in reversed(photos)]
    both = read_transforms(file(*(frame(file_path=path) for path in paths)))
    assert [found.width for found in cameras_of_photos(both, photos)[0].values()] == [640, 640]


@pytest.mark.parametrize("turned", [False, True])
def test_a_file_without_sizes_is_of_its_photos(tmp_path: Path, turned: bool) -> None:
    """As Blender's scripts write it: an angle for all, paths without a suffix."""
    photo = tmp_path / "r_0.png"
    exif = Image.Exif()
    exif[0x0112] = 6 if turned else 1
    Image.new("RGB", (80, 60)).save(photo, exif=exif)
    source = tmp_path / "transforms_train.json"
    matrix = np.eye(4).tolist()
    entries = [{"file_path": f"./train/r_{k}", "transform_matrix": matrix} for k in range(2)]
    source.write_text(json.dumps({"camera_angle_x": 0.7, "frames": entries}))
    (one, two) = read_cameras_of([photo], source).cameras
    width, height = (60, 80) if turned else (80, 60)
    assert (one.width, one.height, one.cx, one.cy) == (width, height, width / 2, height / 2)
    assert one.fx == two.fx == pytest.approx(width / 2 / np.tan(0.35))
    with pytest.raises(InputError, match="no 'w' and 'h'"):
        read_transforms(source)
    gone = tmp_path / "gone.png"
    assert read_cameras_of([gone, photo], source).cameras[0].width == width
    with pytest.raises(InputError, match="no 'w' and 'h'"):
        read_cameras_of([gone], source)


def test_a_file_that_says_sizes_needs_no_photo(tmp_path: Path) -> None:
    source = tmp_path / "cameras.json"
    write_transforms(source, [Camera(np.eye(4), 50, 50, 20, 20, 40, 40)], ["a.jpg"])
    assert read_cameras_of([tmp_path / "gone.png"], source).cameras[0].width == 40
