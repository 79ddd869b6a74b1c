"""Procedural scenes: cameras, depth and photographs agree, and shards are whole."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.ndimage import map_coordinates

from styl3r_export.scenes import SceneViews, TextureBank, generate
from styl3r_export.scenes.__main__ import main
from styl3r_export.scenes.generate import KINDS
from styl3r_export.scenes.lighting import look_at
from styl3r_export.scenes.meshes import box, quad, spin
from styl3r_export.scenes.paths import MIN_OVERLAP
from styl3r_export.scenes.shards import open_shard, shard_paths
from styl3r_export.scenes.solids import blob
from styl3r_export.scenes.visibility import first_hits, to_camera

SIZE = (64, 64)


@pytest.fixture(scope="module")
def bank() -> TextureBank:
    return TextureBank.procedural(3, count=12)


def cast(vertices: np.ndarray, extrinsics: np.ndarray, size: int = 64) -> tuple:
    inverse, hits = np.empty((size, size), np.float32), np.empty((size, size), np.int32)
    lens = (float(size), float(size), size / 2, size / 2)
    first_hits(to_camera(vertices, extrinsics), lens, inverse, hits)
    grid = (np.arange(size) + 0.5 - size / 2) / size
    rays = np.stack([*np.meshgrid(grid, grid), np.ones((size, size))], -1)
    return inverse, hits, rays


def test_depth_of_a_tilted_plane_is_analytic() -> None:
    extrinsics = look_at(np.array([0.3, -2.0, 1.5]), np.array([0.0, 0.0, 0.0]), 0.2)
    inverse, hits, rays = cast(quad((-50, -50, 0), (100, 0, 0), (0, 100, 0)).vertices, extrinsics)
    normal, height = extrinsics[:3, :3] @ [0, 0, 1.0], extrinsics[:3, :3] @ [0, 0, 1.0]
    height = normal @ extrinsics[:3, 3]
    expected = rays @ normal / height
    below = (hits >= 0) & (1 / np.maximum(expected, 1e-9) < 40)
    assert below.mean() > 0.5
    np.testing.assert_allclose(inverse[below], expected[below], rtol=1e-4)


def test_depth_of_a_sphere_is_close_to_analytic() -> None:
    extrinsics = look_at(np.array([0.0, -4.0, 0.0]), np.zeros(3))
    inverse, hits, rays = cast(blob((1, 1, 1), None, 64).vertices, extrinsics)
    squared = (rays**2).sum(-1)
    root = 16.0 - squared * 15.0  # of t^2 |d|^2 - 8 t + 15 = 0, with d_z = 1
    depth = (4.0 - np.sqrt(np.maximum(root, 0))) / squared
    inside = root > 0.5
    assert (hits >= 0)[inside].all()
    assert not (hits >= 0)[root < -0.1].any()
    np.testing.assert_allclose(1 / inverse[inside], depth[inside], atol=0.01)


def test_a_camera_inside_a_box_sees_all_of_it() -> None:
    """Triangles that cross the camera plane are neither lost nor seen behind the back."""
    inverse, hits, rays = cast(
        box((2, 4, 3)).vertices, look_at(np.zeros(3), np.array([0.1, 1, 0.2]))
    )
    assert (hits >= 0).all()
    extrinsics = look_at(np.zeros(3), np.array([0.1, 1, 0.2]))
    world = np.abs((rays / inverse[..., None]) @ extrinsics[:3, :3])
    np.testing.assert_allclose((world / [1, 2, 1.5]).max(-1), 1.0, atol=1e-4)


def warp_error(scene: SceneViews, source: int, target: int) -> tuple[float, float]:
    """Median colour difference of pixels carried over by depth, and the share carried."""
    height, width = scene.depth.shape[1:]
    k = scene.intrinsics[0] * np.array([[width], [height], [1]])
    grid = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), -1)
    rays = np.concatenate([(grid - k[:2, 2]) / k[[0, 1], [0, 1]], np.ones((height, width, 1))], -1)
    relative = scene.extrinsics[target] @ np.linalg.inv(scene.extrinsics[source])
    q = (rays * scene.depth[source][..., None]) @ relative[:3, :3].T + relative[:3, 3]
    uv = q[..., :2] / q[..., 2:] * k[[0, 1], [0, 1]] + k[:2, 2] - 0.5
    there = map_coordinates(scene.depth[target], [uv[..., 1], uv[..., 0]], order=0, cval=0)
    seen = (q[..., 2] > 0) & (np.abs(there / q[..., 2] - 1) < 0.03)
    colours = [
        map_coordinates(c, [uv[..., 1], uv[..., 0]], order=1, cval=0) for c in scene.images[target]
    ]
    difference = np.abs(np.stack(colours) - scene.images[source]).max(0)
    return float(np.median(difference[seen])), float(seen.mean())


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_views_agree_through_depth_and_cameras(bank: TextureBank, kind: str) -> None:
    scene = generate(6, 3, (128, 128), bank, kind=kind, photometric=False)
    turned = scene.extrinsics.copy()
    turned[1:, :3] = spin(np.radians(3), axis=1) @ turned[1:, :3]
    wrong = replace(scene, extrinsics=turned)  # a camera error of 3 degrees must show
    for target in (1, 2):
        error, seen = warp_error(scene, 0, target)
        assert seen > 0.25
        assert error < 0.05
        assert warp_error(wrong, 0, target)[0] > 1.5 * error  # textures alias from far apart


def test_contract_and_determinism(bank: TextureBank) -> None:
    first, again = generate(11, 4, SIZE, bank), generate(11, 4, SIZE, bank)
    assert first.images.shape == (4, 3, 64, 64)
    assert first.images.dtype == np.float32
    assert 0 <= first.images.min() <= first.images.max() <= 1
    np.testing.assert_array_equal(first.extrinsics[0], np.eye(4))
    assert (first.depth > 0).all()
    for name in ("images", "depth", "sky", "extrinsics", "intrinsics"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert np.abs(generate(12, 4, SIZE, bank).images - first.images).mean() > 0.02


def test_every_view_overlaps_the_first(bank: TextureBank) -> None:
    for seed in range(6):
        scene = generate(seed, 4, SIZE, bank, photometric=False)
        for view in (1, 2, 3):
            height = scene.depth.shape[1]
            assert scene.intrinsics[0, 0, 0] > 0.6  # below 80 degrees
            relative = scene.extrinsics[view]
            grid = (np.arange(height) + 0.5) / height - 0.5
            rays = np.stack([*np.meshgrid(grid, grid), np.ones((height, height))], -1)
            rays[..., :2] /= scene.intrinsics[0, 0, 0]
            q = (rays * scene.depth[0][..., None]) @ relative[:3, :3].T + relative[:3, 3]
            uv = (q[..., :2] / q[..., 2:] * scene.intrinsics[0, 0, 0] + 0.5) * height - 0.5
            there = map_coordinates(scene.depth[view], [uv[..., 1], uv[..., 0]], order=0, cval=0)
            seen = (q[..., 2] > 0) & (q[..., 2] < there * 1.05)
            assert seen.mean() >= MIN_OVERLAP - 0.02


def test_shards_resume_and_are_normalised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("styl3r_export.scenes.textures.PATTERN_COUNT", 6)
    options = ["--out", str(tmp_path), "--count", "2", "--views", "2", "--size", "48"]
    assert CliRunner().invoke(main, options, catch_exceptions=False).exit_code == 0
    (path,) = shard_paths(tmp_path)
    shard = open_shard(path)
    assert shard.images.shape == (2, 2, 3, 48, 48)
    assert shard.images.dtype == np.uint8
    for scene in range(2):
        depth = shard.depth[scene, 0].astype(np.float32)[~shard.sky[scene, 0]]
        assert abs(np.median(depth) - 1) < 2e-3
    before = (path / "images.npy").stat().st_mtime_ns
    assert CliRunner().invoke(main, options, catch_exceptions=False).exit_code == 0
    assert (path / "images.npy").stat().st_mtime_ns == before
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_textures_from_a_folder(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no picture"):
        TextureBank.from_folder(tmp_path)


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        ("--count 0", 2, "'--count'"),
        ("--count 1 --views 0", 2, "'--views'"),
        ("--count 1 --size 0", 2, "'--size'"),
        ("--count 1 --workers 0", 2, "'--workers'"),
        ("--count 1", 6, "cannot write {out}: Not a directory"),
    ],
)
def test_mistakes_are_told(tmp_path: Path, options: str, code: int, words: str) -> None:
    (tmp_path / "file").write_bytes(b"")
    out = tmp_path / "file" / "shards"
    result = CliRunner().invoke(main, ["--out", str(out), *options.split()])
    assert result.exit_code == code
    assert words.format(out=out) in result.stderr
