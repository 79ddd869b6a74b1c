"""Scenes from elsewhere: chunks of videos, COLMAP folders, generated shards."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation
from striped_scene import FOCAL, PHOTOS, SIDE, write_scene

from styl3r_cli.errors import InputError
from styl3r_export.chunks import find_videos, read_chunk
from styl3r_export.evaluate.__main__ import main
from styl3r_export.evaluate.colmap_scenes import load_colmap
from styl3r_export.evaluate.generated import generated_scenes
from styl3r_export.evaluate.groups import choose_groups
from styl3r_export.evaluate.scenes import load_scene
from styl3r_export.evaluate.videos import Entry, context_frames
from styl3r_export.scenes.shards import Plan, write_shard
from styl3r_export.scenes.textures import TextureBank

Medians = dict[tuple[str, ...], float]


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scene(tmp_path_factory.mktemp("scenes") / "stripes")


def facts(stored: Path) -> dict[str, dict]:
    return json.loads((stored / "cameras.json").read_text())["images"]


def run(model: Path, output: Path, *options: object) -> tuple[str, Medians]:
    """The printed table, and all medians by kind, views, what, measure and method."""
    arguments = [model, "--size", SIDE, "--json", output, *options]
    result = CliRunner().invoke(main, [*map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    keys = ("kind", "views", "what", "measure", "method")
    summaries = json.loads(output.read_text())["summaries"]
    return result.stdout, {tuple(s[k] for k in keys): s["median"] for s in summaries}


# ------------------------------------------------------------------ videos in chunks


def write_chunk(stored: Path, folder: Path, *, listed: bool) -> Path:
    """The striped scene as one video of a chunk, beside another video."""
    folder.mkdir()
    frames, cameras = [], []
    for name, fact in facts(stored).items():
        with Image.open(stored / "images" / name) as photo:
            buffer = io.BytesIO()
            photo.save(buffer, "JPEG", quality=95)
        frames.append(torch.frombuffer(bytearray(buffer.getvalue()), dtype=torch.uint8))
        lens = [fact["fx"] / SIDE, fact["fy"] / SIDE, fact["cx"] / SIDE, fact["cy"] / SIDE]
        cameras.append([*lens, 0, 0, *np.array(fact["w2c"])[:3].ravel()])
    video = {
        "url": "", "key": "stripes", "timestamps": torch.arange(len(frames)),
        "images": frames, "cameras": torch.tensor(cameras, dtype=torch.float32),
    }  # fmt: skip
    wide = video["cameras"].clone()
    wide[:, :2] = 0.4  # 103 degrees across
    torch.save([video, video | {"key": "wide", "cameras": wide}], folder / "000000.torch")
    if listed:
        index = {"stripes": "000000.torch", "wide": "000000.torch"}
        (folder / "index.json").write_text(json.dumps(index))
    return folder


def write_index(path: Path) -> Path:
    entry = {"context": [0, 4], "target": [1, 2], "overlap": 0.7}
    path.write_text(json.dumps({"stripes": entry, "wide": entry, "elsewhere": entry, "no": None}))
    return path


@pytest.mark.parametrize("listed", [True, False])
def test_videos_with_an_index(stored: Path, tiny_model: Path, tmp_path: Path, listed: bool) -> None:
    chunks = write_chunk(stored, tmp_path / "chunks", listed=listed)
    index = write_index(tmp_path / "index.json")
    options = ("--re10k", chunks, "--index", index, "--rows", "cameras,views,depth")
    text, medians = run(tiny_model, tmp_path / "out.json", *options, "--views", "2,3,4")
    assert "RE10K scenes, 2 views: 1 scenes, 1 groups" in text
    for views in (2, 3):  # not 4: three frames are left between and beside the two to be drawn
        row = {k[2:]: v for k, v in medians.items() if k[:2] == ("RE10K", views)}
        assert row["cameras", "rotation (deg)", "model"] < 0.05
        assert row["cameras", "direction (deg)", "model"] < 0.5
        assert row["cameras", "focal length (relative)", "model"] < 1e-3
        assert row["novel view", "PSNR (dB)", "nearest photo"] > 40  # all photos look the same
        assert not any(what == "depth" for what, *_ in row)  # which nobody knows
        assert ("novel view", "PSNR (dB)", "homography (oracle)") not in row
    assert not any(key[1] == 4 for key in medians)
    (group, _) = json.loads((tmp_path / "out.json").read_text())["groups"]
    assert group["inputs"] == ["frame 0", "frame 4"]
    assert group["targets"] == ["frame 1", "frame 2"]


def test_frames_between_the_index_s_own() -> None:
    entry = Entry((10, 70), (30, 40))
    assert context_frames(entry, 2) == (10, 70)
    assert context_frames(entry, 3) == (10, 39, 70)  # 40 is to be drawn
    assert context_frames(entry, 4) == (10, 29, 50, 70)
    assert context_frames(Entry((10, 12), (11,)), 3) is None
    assert context_frames(Entry((1, 5, 9), (3,)), 2) is None


class Trap:
    """Creates a file when its pickle is executed."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple:
        return (Path.touch, (self.path,))


def test_chunks_are_never_executed(tmp_path: Path) -> None:
    sprung = tmp_path / "sprung"
    video = {"key": "k", "images": [], "cameras": torch.zeros(0, 18), "extra": Trap(sprung)}
    torch.save([video], tmp_path / "a.torch")
    assert read_chunk(tmp_path / "a.torch")[0].key == "k"
    assert find_videos(tmp_path) == {"k": tmp_path / "a.torch"}
    assert not sprung.exists()


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ({"key": "k"}, "holds no list"),
        ([{"key": "k"}], "item 0 has no"),
        ([{"key": "k", "images": [], "cameras": torch.zeros(2, 18)}], "for 0 frames"),
        ([{"key": "k", "images": [1], "cameras": torch.zeros(1, 18)}], "no tensors"),
    ],
)
def test_damaged_chunks_say_what_is_wrong(tmp_path: Path, content: object, complaint: str) -> None:
    torch.save(content, tmp_path / "a.torch")
    with pytest.raises(InputError, match=complaint):
        read_chunk(tmp_path / "a.torch")


# ------------------------------------------------------------------ COLMAP


def colmap_tables(stored: Path) -> tuple[list, list, list]:
    """Cameras, images and points of the striped scene as COLMAP has them."""
    with np.load(stored / "points.npz") as archive:
        points = dict(archive)
    images = []
    for number, (name, fact) in enumerate(facts(stored).items(), 1):
        w2c = np.array(fact["w2c"])
        quaternion = np.roll(Rotation.from_matrix(w2c[:3, :3]).as_quat(), 1)  # w first
        seen = points["obs_image"] == number - 1
        uv, ids = points["obs_uv"][seen].tolist(), points["obs_point"][seen].tolist()
        found = [(*at, point + 1) for at, point in zip(uv, ids, strict=True)]
        found.append((1.5, 2.5, -1))  # a feature without a point
        images.append((number, quaternion, w2c[:3, 3], 7, name, found))
    cameras = [(7, SIDE, SIDE, (FOCAL, FOCAL, SIDE / 2, SIDE / 2))]
    return cameras, images, [(k + 1, xyz) for k, xyz in enumerate(points["xyz"].astype(float))]


def write_text(folder: Path, cameras: list, images: list, points: list) -> None:
    lines = ["# a comment"]
    lines += [f"{n} PINHOLE {w} {h} {' '.join(map(repr, p))}" for n, w, h, p in cameras]
    (folder / "cameras.txt").write_text("\n".join(lines))
    lines = ["# another"]
    for number, quaternion, translation, lens, name, found in images:
        pose = " ".join(repr(float(v)) for v in (*quaternion, *translation))
        lines += [
            f"{number} {pose} {lens} {name}",
            " ".join(f"{x!r} {y!r} {p}" for x, y, p in found),
        ]
    (folder / "images.txt").write_text("\n".join(lines))
    lines = [f"{n} {' '.join(repr(float(v)) for v in xyz)} 9 9 9 0.5 1 2" for n, xyz in points]
    (folder / "points3D.txt").write_text("\n".join(lines))


def write_binary(folder: Path, cameras: list, images: list, points: list) -> None:
    data = struct.pack("<Q", len(cameras))
    for number, width, height, parameters in cameras:
        data += struct.pack("<iiQQ4d", number, 1, width, height, *parameters)
    (folder / "cameras.bin").write_bytes(data)
    data = struct.pack("<Q", len(images))
    for number, quaternion, translation, lens, name, found in images:
        data += struct.pack("<i7di", number, *quaternion, *translation, lens)
        data += name.encode() + b"\0" + struct.pack("<Q", len(found))
        data += b"".join(struct.pack("<ddq", *row) for row in found)
    (folder / "images.bin").write_bytes(data)
    data = struct.pack("<Q", len(points))
    for number, xyz in points:
        data += struct.pack("<Q3d3BdQ", number, *xyz, 9, 9, 9, 0.5, 2) + struct.pack(
            "<4i", 1, 2, 3, 4
        )
    (folder / "points3D.bin").write_bytes(data)


@pytest.mark.parametrize("form", ["binary", "text"])
def test_colmap_folders_give_what_the_stored_scene_gives(
    stored: Path, tiny_model: Path, tmp_path: Path, form: str
) -> None:
    scene = tmp_path / "train"
    (scene / "sparse" / "0").mkdir(parents=True)
    (scene / "images").symlink_to(stored / "images")
    write = write_binary if form == "binary" else write_text
    write(scene / "sparse" / "0", *colmap_tables(stored))
    rows = ("--rows", "depth,cameras,views", "--views", "2,4", "--per-scene", "2")
    text, medians = run(tiny_model, tmp_path / "a.json", "--colmap", scene, *rows)
    _, expected = run(tiny_model, tmp_path / "b.json", "--scenes", stored.parent, *rows)
    assert "COLMAP scenes, 4 views: 1 scenes, 2 groups" in text
    assert len(medians) == len(expected)
    for (_, *key), value in expected.items():
        if "homography (oracle)" in key:
            continue  # of the nearest photo, and both inputs are equally near
        assert medians["COLMAP", *key] == pytest.approx(value, rel=1e-4, abs=1e-4), key
    damaged = scene / "sparse" / "0" / ("images.bin" if form == "binary" else "images.txt")
    damaged.write_bytes(damaged.read_bytes()[:500])
    with pytest.raises(InputError, match="not COLMAP's"):
        load_colmap(scene, SIDE)


def test_bent_photos_are_straightened(tmp_path: Path) -> None:
    """Dots drawn where an OPENCV lens sees points appear where the pinhole camera sees them."""
    import cv2

    scene = tmp_path / "bent"
    (scene / "images").mkdir(parents=True)
    width, height, lens = 200, 160, (150.0, 155.0, 97.0, 83.0, -0.2, 0.05, 0.003, -0.002)
    points = np.array([[x, y, 4.0] for x in (-1.6, 0.1, 1.7) for y in (-1.2, 0.2, 1.2)])
    matrix = np.array([[lens[0], 0, lens[2]], [0, lens[1], lens[3]], [0, 0, 1]])
    uv = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(lens[4:]))[0][:, 0]
    y, x = np.mgrid[0:height, 0:width] + 0.5
    dots = sum(np.exp(-((x - u) ** 2 + (y - v) ** 2) / 8) for u, v in uv)
    picture = np.repeat((np.clip(dots, 0, 1) * 255).astype(np.uint8)[..., None], 3, axis=2)
    Image.fromarray(picture).save(scene / "images" / "a b.png")
    found = [(*p, k) for k, p in enumerate(uv.tolist())]
    (scene / "cameras.txt").write_text(f"1 OPENCV {width} {height} {' '.join(map(str, lens))}")
    row = " ".join(f"{a!r} {b!r} {c}" for a, b, c in found)
    (scene / "images.txt").write_text(f"1 2 0 0 0 0 0 0 1 a b.png\n{row}\n")
    table = [f"{k} {p[0]} {p[1]} {p[2]} 0 0 0 0" for k, p in enumerate(points)]
    (scene / "points3D.txt").write_text("\n".join(table))
    (view,) = load_colmap(scene, 160).views
    assert len(view.points) == 9
    projected = points[view.points] @ view.camera.intrinsics.T
    np.testing.assert_allclose(view.uv, projected[:, :2] / projected[:, 2:], atol=0.02)
    for u, v in view.uv:
        left, top = int(u) - 6, int(v) - 6
        patch = view.pixels[top : top + 13, left : left + 13, 0].astype(float)
        rows, columns = np.mgrid[0:13, 0:13] + 0.5
        middle = [(columns * patch).sum() / patch.sum(), (rows * patch).sum() / patch.sum()]
        np.testing.assert_allclose([left + middle[0], top + middle[1]], [u, v], atol=0.15)
    (scene / "cameras.txt").write_text(f"1 OPENCV_FISHEYE {width} {height} 1 1 1 1 0 0 0 0")
    with pytest.raises(InputError, match="image_undistorter"):
        load_colmap(scene, 160)


# ------------------------------------------------------------------ generated scenes


@pytest.fixture(scope="module")
def shards(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("shards")
    plan = Plan(seed=11, views=5, size=(SIDE, SIDE), scenes=2)
    write_shard(folder, 0, plan, TextureBank.procedural(0))
    return folder


@pytest.mark.parametrize("size", [SIDE, 96])
def test_generated_scenes_agree_between_their_views(shards: Path, size: int) -> None:
    (name, read), _ = generated_scenes(shards, size)
    scene = read()
    assert "seed 11" in name
    first, second = scene.views[:2]
    _, a, b = np.intersect1d(first.points, second.points, return_indices=True)
    assert len(a) > 30
    grey = [gaussian_filter(view.pixels.mean(axis=-1), 1.0) for view in (first, second)]
    colours = [
        g[tuple(view.uv[k].astype(int).T[::-1])]
        for g, view, k in zip(grey, (first, second), (a, b), strict=True)
    ]
    assert np.corrcoef(*colours)[0, 1] > 0.8  # exposure and noise differ, what is shown does not
    for view in scene.views:
        uv, depth = view.truth
        assert np.isfinite(depth).all()
        columns, rows = (uv - 0.5).astype(int).T
        np.testing.assert_array_equal(view.depth_map[rows, columns], depth)
        columns, rows = view.uv.astype(int).T
        np.testing.assert_allclose(view.depth_map[rows, columns], view.depth, rtol=0.031)


def test_generated_scenes_stand_in_the_same_table(
    shards: Path, stored: Path, tiny_model: Path, tmp_path: Path
) -> None:
    options = ("--shards", shards, "--scenes", stored.parent, "--rows", "depth,cameras,views")
    text, medians = run(tiny_model, tmp_path / "a.json", *options, "--per-scene", "2")
    assert "generated scenes, 2 views: 2 scenes" in text
    assert "validation scenes, 2 views: 1 scenes" in text
    for what, measure, method in (
        ("depth", "AbsRel, one scale", "plane (oracle)"),
        ("cameras", "rotation (deg)", "SIFT + E"),
        ("cameras", "focal length (relative)", "model"),
    ):
        assert ("generated", 2, what, measure, method) in medians
    # Nothing that is told beforehand is known of generated depth but its scale.
    assert 0.02 < medians["generated", 2, "depth", "AbsRel, one scale", "constant"] < 2


def test_truth_that_is_known_gets_full_marks(shards: Path) -> None:
    """Depth rows of the true point maps are right wherever no edge runs through a pixel."""
    from styl3r_export.evaluate.depth import depth_values

    for _, read in generated_scenes(shards, SIDE):
        scene = read()
        for group in choose_groups(scene, 2, 2):
            cameras = [view.camera for view in group.views]
            means = np.stack([point_map(view) for view in group.views])
            values = depth_values(group, means * 3, [moved(camera, 3) for camera in cameras])
            assert values["depth", "AbsRel, one scale", "model"][0] < 1e-4
            assert values["depth", "AbsRel, one scale", "constant"][0] > 0.01


def point_map(view) -> NDArray[np.float32]:
    camera = view.camera
    v, u = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], -1)
    here = rays * view.depth_map[..., None]
    return ((here - camera.extrinsics[:3, 3]) @ camera.extrinsics[:3, :3]).astype(np.float32)


def moved(camera, factor: float):
    from dataclasses import replace

    extrinsics = camera.extrinsics.copy()
    extrinsics[:3, 3] *= factor
    return replace(camera, extrinsics=extrinsics)


def test_scenes_can_be_counted_off(
    shards: Path, stored: Path, tiny_model: Path, tmp_path: Path
) -> None:
    options = ("--shards", shards, "--rows", "cameras", "--views", "2", "--most", "1")
    text, _ = run(tiny_model, tmp_path / "a.json", *options)
    assert "generated scenes, 2 views: 1 scenes" in text
    assert len(load_scene(stored, SIDE).views) == PHOTOS


def test_mistakes_get_one_line(stored: Path, tiny_model: Path, tmp_path: Path) -> None:
    chunks = write_chunk(stored, tmp_path / "chunks", listed=True)
    index = tmp_path / "index.json"
    for text, arguments, code in (
        ("{}", [], 2),
        ("{}", ["--re10k", chunks], 2),
        ("{}", ["--re10k", chunks, "--index", index], 3),
        ("[1]", ["--re10k", chunks, "--index", index], 3),
        (
            '{"stripes": {"context": [0, 9], "target": [1]}}',
            ["--re10k", chunks, "--index", index],
            3,
        ),
        ("{}", ["--colmap", chunks], 3),
        ("{}", ["--shards", chunks], 3),
    ):
        index.write_text(text)
        command = [tiny_model, "--size", SIDE, *arguments]
        result = CliRunner().invoke(main, [str(part) for part in command])
        assert result.exit_code == code, (arguments, result.output)
        assert "Traceback" not in result.stderr
        assert "Error" in result.stderr
