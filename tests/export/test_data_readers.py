"""Readers of the published training data, on chunks whose frames tell their own number."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from plane_scene import perfect_prediction, plane_group
from scipy.spatial.transform import Rotation

from styl3r_cli.errors import InputError
from styl3r_export.curriculum.data import Batch
from styl3r_export.curriculum.data_readers import (
    DL3DV,
    RE10K,
    DataSet,
    GapSchedule,
    PaintingFolder,
    VideoBatch,
    inputs_only,
    joined,
    video_batches,
)
from styl3r_export.curriculum.data_readers.sampling import choose_frames
from styl3r_export.curriculum.photometric import PhotometricStep, draw_targets
from styl3r_export.curriculum.pictures import PictureBank, flat_batches
from styl3r_export.curriculum.stylization import StyleStep, style_batches
from styl3r_export.evaluate.align import Similarity
from styl3r_export.evaluate.image_metrics import psnr
from styl3r_export.model import ModelConfig, build

WIDTH, HEIGHT, LENGTH, SIDE = 64, 36, 40, 32
FOCAL_X, FOCAL_Y = 0.6, 1.0  # normalised by width and height
DATA = DataSet(GapSchedule((4, 6), (8, 20), steps=100), (WIDTH, HEIGHT))
FLIP = np.diag([-1.0, 1, 1, 1])


def pose(number: int) -> np.ndarray:
    """World-to-camera of a frame: a curved path, turning."""
    w2c = np.eye(4)
    w2c[:3, :3] = Rotation.from_rotvec([0.01 * number, -0.02 * number, 0.3]).as_matrix()
    w2c[:3, 3] = [0.1 * number, 0.002 * number**2, -0.05 * number]
    return w2c


def frame(number: int, size: tuple[int, int] = (WIDTH, HEIGHT)) -> torch.Tensor:
    """Green tells the number, red the side."""
    pixels = np.zeros((size[1], size[0], 3), np.uint8)
    pixels[..., 1] = 6 * number
    pixels[:, size[0] // 2 :, 0] = 200
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")  # decoders go by content; PNG is exact
    return torch.frombuffer(bytearray(buffer.getvalue()), dtype=torch.uint8)


def video(key: str, length: int = LENGTH, *, focal: float = FOCAL_X, size=(WIDTH, HEIGHT)) -> dict:
    lens = [focal, FOCAL_Y, 0.5, 0.5, 0, 0]
    cameras = [[*lens, *pose(k)[:3].ravel()] for k in range(length)]
    return {
        "key": key, "images": [frame(k, size) for k in range(length)],
        "cameras": torch.tensor(cameras, dtype=torch.float32), "timestamps": torch.arange(length),
    }  # fmt: skip


@pytest.fixture(scope="module")
def chunks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("chunks")
    unusable = [video("short", 3), video("wide", focal=0.3), video("large", size=(80, 45))]
    torch.save([video("a"), *unusable], folder / "000000.torch")
    still = video("still")
    still["cameras"][:, 6:] = still["cameras"][0, 6:]
    torch.save([video("b"), still, video("c")], folder / "000001.torch")
    return folder


def numbers(batch: Batch) -> torch.Tensor:
    """(B, V) which frames these are."""
    return (batch.images[:, :, 1].mean(dim=(-2, -1)) * 255 / 6).round().long()


def is_mirrored(batch: Batch) -> bool:
    return bool(batch.images[..., 0, :, : SIDE // 4].mean() > 0.5)


def test_frames_come_with_their_cameras(chunks: Path) -> None:
    batches = video_batches(chunks, DATA, 0, 2, inputs=3, targets=4, side=SIDE)
    seen, sides = set(), set()
    for batch in (next(batches) for _ in range(8)):
        assert batch.inputs.images.shape == (2, 3, 3, SIDE, SIDE)
        assert batch.targets.images.shape == (2, 4, 3, SIDE, SIDE)
        seen |= set(batch.keys)
        sides.add(is_mirrored(batch.inputs))
        assert is_mirrored(batch.inputs) == is_mirrored(batch.targets)
        flip = FLIP if is_mirrored(batch.inputs) else np.eye(4)
        for scene in range(2):
            given, drawn = (numbers(part)[scene].tolist() for part in (batch.inputs, batch.targets))
            first, between, last = given
            assert first < between < last
            assert all(first <= k <= last for k in drawn)
            away = np.linalg.inv(pose(last))[:3, 3] - np.linalg.inv(pose(first))[:3, 3]
            for part, frames in ((batch.inputs, given), (batch.targets, drawn)):
                expected = [flip @ pose(k) @ np.linalg.inv(pose(first)) @ flip for k in frames]
                expected = np.stack(expected)
                expected[:, :3, 3] /= np.linalg.norm(away)
                np.testing.assert_allclose(part.extrinsics[scene], expected, atol=1e-4)
    assert seen == {"a", "b", "c"}  # others are too short, too wide, still, or of another size
    assert sides == {True, False}


def test_lenses_are_those_of_the_crop(chunks: Path) -> None:
    batch = next(video_batches(chunks, DATA, 1, 1, side=SIDE)).inputs
    resized = round(WIDTH * SIDE / HEIGHT)
    cx = (resized / 2 - (resized - SIDE) // 2) / SIDE
    cx = 1 - cx if is_mirrored(batch) else cx
    expected = torch.tensor([[FOCAL_X * resized / SIDE, 0, cx], [0, FOCAL_Y, 0.5], [0, 0, 1]])
    torch.testing.assert_close(batch.intrinsics[0, 0], expected)
    edge = (batch.images[0, 0, 0, SIDE // 2] > 0.4).float()  # red starts in the photo's middle
    start = edge.argmax() if not is_mirrored(batch) else edge.argmin()
    assert abs(float(start) - float(cx) * SIDE) <= 1


def test_inputs_move_apart_as_training_goes_on(chunks: Path) -> None:
    for step, least, most in ((0, 4, 6), (50, 6, 13), (100, 8, 20), (10**6, 8, 20)):
        assert DATA.gaps.bounds(step) == (least, most)
        batches = video_batches(chunks, DATA, 0, 1, first_step=step, targets=1, side=SIDE)
        gaps = [int(numbers(next(batches).inputs)[0].diff()) for _ in range(12)]
        assert least <= min(gaps) <= max(gaps) <= DATA.gaps.bounds(step + 12)[1]
        assert len(set(gaps)) > 1
    assert RE10K.gaps.bounds(0) == (25, 25)
    assert RE10K.gaps.bounds(9375) == (45, 90)
    assert DL3DV.gaps.bounds(0) == (5, 7)
    assert DL3DV.gaps.bounds(9375) == (8, 22)


@given(st.integers(0, 2**16), st.integers(2, 60), st.integers(1, 30), st.integers(0, 30),
       st.integers(2, 8))  # fmt: skip
@settings(max_examples=100, deadline=None)
def test_chosen_frames_keep_to_the_rules(
    seed: int, length: int, least: int, more: int, inputs: int
) -> None:
    rng, bounds = np.random.default_rng(seed), (least, least + more)
    chosen = choose_frames(rng, length, bounds, inputs, 5)
    if chosen is None:
        assert length - 1 < max(least, inputs - 1) or least + more < inputs - 1
        return
    first, *between, last = chosen.inputs
    assert 0 <= first < last < length
    assert least <= last - first <= least + more
    assert len(set(chosen.inputs)) == inputs
    assert all(first < k < last for k in between)
    assert len(chosen.targets) == 5
    assert all(first <= k <= last for k in chosen.targets)


def test_the_same_seed_gives_the_same_batches(chunks: Path) -> None:
    one, two, other = (next(video_batches(chunks, DATA, seed, 3, side=SIDE)) for seed in (5, 5, 6))
    assert one.keys == two.keys
    assert torch.equal(one.inputs.images, two.inputs.images)
    assert not torch.equal(one.inputs.images, other.inputs.images)


def test_data_sets_are_joined_within_a_batch(chunks: Path) -> None:
    sources = [video_batches(chunks, DATA, seed, 2, side=SIDE) for seed in (0, 1)]
    apart = [next(video_batches(chunks, DATA, seed, 2, side=SIDE)) for seed in (0, 1)]
    batch = next(joined(*sources))
    assert batch.keys == apart[0].keys + apart[1].keys
    assert torch.equal(batch.targets.images[2:], apart[1].targets.images)


def test_a_folder_without_usable_videos_is_an_error(chunks: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no video can be used"):
        next(video_batches(chunks, RE10K, 0, 1))
    with pytest.raises(InputError, match="no chunks"):
        next(video_batches(tmp_path, RE10K, 0, 1))


# ------------------------------------------------------------------ paintings


@pytest.fixture(scope="module")
def paintings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("wikiart")
    rng = np.random.default_rng(0)
    for genre, count in (("Cubism", 12), ("Pop_Art", 5)):
        (root / genre).mkdir()
        for k in range(count):
            pixels = rng.integers(0, 255, (50 + k, 70, 3), np.uint8)
            Image.fromarray(pixels).save(root / genre / f"{k:02}.jpg")
    (root / "notes.txt").write_text("not a picture")
    return root


def test_paintings_are_split_in_each_genre(paintings: Path) -> None:
    training, validation = PaintingFolder(paintings), PaintingFolder(paintings, validation=True)
    kept = [f"{p.parent.name}/{p.name}" for p in validation.files]
    assert kept == ["Cubism/00.jpg", "Cubism/10.jpg", "Pop_Art/00.jpg"]
    assert len(training.files) == 14
    assert not set(training.files) & set(validation.files)
    with pytest.raises(InputError, match="no pictures"):
        PaintingFolder(paintings / "notes")


def test_each_scene_has_its_painting(paintings: Path) -> None:
    folder, keys = PaintingFolder(paintings), [f"scene {k}" for k in range(40)]
    pictures = folder.paired(keys, 32)
    assert pictures.shape == (40, 3, 32, 32)
    assert torch.equal(pictures, PaintingFolder(paintings).paired(keys, 32))
    assert len({folder.of_scene(key) for key in keys}) > 8
    assert pictures.std() > 0.1


def test_damaged_paintings_are_passed_over(paintings: Path, tmp_path: Path) -> None:
    for k in range(6):
        (tmp_path / f"{k}.jpg").write_bytes(b"no picture")
    good = (paintings / "Cubism" / "03.jpg").read_bytes()
    (tmp_path / "7.jpg").write_bytes(good)
    crops = PaintingFolder(tmp_path).crops(np.random.default_rng(0), 2, 16)
    assert crops.shape == (2, 3, 16, 16)
    (tmp_path / "7.jpg").unlink()
    with pytest.raises(InputError, match="not a readable picture"):
        PaintingFolder(tmp_path).crops(np.random.default_rng(0), 1, 16)


# ------------------------------------------------------------------ training on them

# The published network's shape, small.
TINY = ModelConfig(
    name="tiny", head_dim=16, encoder_dim=32, encoder_depth=2, style_depth=1, decoder_dim=32,
    decoder_depth=3, stylizer_depth=3, hooks=(1, 2, 3), head_maps=(8, 8, 8, 8), head_features=8,
    point_features=8,
)  # fmt: skip


class Blur(torch.nn.Module):
    """A perceptual network that needs no weights: the picture at four scales."""

    def forward(self, images: torch.Tensor) -> list[torch.Tensor]:
        """Averages of 1, 2, 4 and 8 pixels."""
        return [torch.nn.functional.avg_pool2d(images, 2**k) for k in range(4)]


def test_the_photometric_stage_trains_the_published_network(chunks: Path) -> None:
    torch.manual_seed(0)
    model = build(TINY).train()
    # A network without any training has its points in the cameras, and too small to be seen.
    for head, bias in (("downstream_head1", (0, 0, 1)), ("downstream_head2", (0, 0, 1)),
                       ("gaussian_param_head", (1, 90, 90, 90, 0, 0, 0, 1)),
                       ("gaussian_param_head2", (1, 90, 90, 90, 0, 0, 0, 1))):  # fmt: skip
        last = model.get_submodule(f"{head}.dpt.head.4")
        last.bias.data = torch.tensor(bias, dtype=torch.float32)
    batches = video_batches(chunks, DATA, 0, 2, inputs=3, targets=2, side=SIDE)
    losses = PhotometricStep(Blur())(model, next(batches))
    assert set(losses) == {"photometric", "perceptual"}
    torch.stack(list(losses.values())).sum().backward()
    for part in ("downstream_head1", "downstream_head2", "gaussian_param_head",
                 "gaussian_appearance_head", "token_stylizer", "backbone"):  # fmt: skip
        gradients = [p.grad for p in model.get_submodule(part).parameters() if p.grad is not None]
        assert sum(float(g.abs().sum()) for g in gradients) > 0, part


def test_targets_are_drawn_where_they_were_taken() -> None:
    group = plane_group(96)
    _, gaussians = perfect_prediction(group, Similarity(np.eye(3), 1.0, np.zeros(3)))
    target = group.scene.views[1]
    lens = target.camera.intrinsics / np.array([[96], [96], [1.0]])
    fields = (target.image, target.camera.extrinsics, lens)
    image, extrinsics, intrinsics = (torch.tensor(f)[None, None].float() for f in fields)
    wanted = Batch(image, image[:, :, 0] * 0, extrinsics, intrinsics)
    parts = ("means", "scales", "rotations", "opacities", "colours")
    scene = [torch.from_numpy(getattr(gaussians, part)) for part in parts]
    (drawn,) = draw_targets([scene], VideoBatch(wanted, wanted, ["plane"]))
    assert psnr(drawn.permute(1, 2, 0).numpy(), target.pixels / 255) > 26


def test_the_style_stage_takes_videos_and_a_folder_of_paintings(
    chunks: Path, paintings: Path
) -> None:
    scenes = inputs_only(video_batches(chunks, DATA, 0, 2, side=SIDE))
    folder = PaintingFolder(paintings)
    flat = flat_batches(PictureBank(folder.files[:3], 48), 0, 2, SIDE)
    model, step = build(TINY), StyleStep(Blur(), teacher=None)
    seen = set()
    for batch, _ in zip(style_batches(scenes, flat, folder, 0), range(8), strict=False):  # type: ignore[arg-type]
        losses = step(model, batch)
        assert all(torch.isfinite(value) for value in losses.values())
        video_like = bool((batch.scenes.depth == 0).all())
        if "agreement" in losses and video_like:
            assert losses["agreement"] == 0  # nobody knows what is seen where
        seen.add((video_like, *losses))
    assert {video_like for video_like, *_ in seen} == {True, False}


def test_batches_say_that_depth_is_unknown(chunks: Path) -> None:
    batch = next(video_batches(chunks, DATA, 0, 1, side=SIDE))
    assert isinstance(batch, VideoBatch)
    assert float(batch.inputs.depth.abs().max()) == 0
    assert batch.targets.depth.shape == (1, 4, SIDE, SIDE)
