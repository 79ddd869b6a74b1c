"""Training: stages run, move what they may, resume where they stopped."""

from pathlib import Path

import numpy as np
import pytest
import torch
from blurred_scales import Blur
from PIL import Image
from shared_reference import reference_folder

from styl3r_export.checkpoints import load_any
from styl3r_export.curriculum import data, stages
from styl3r_export.curriculum.novel_views import NovelViewStep, quaternions
from styl3r_export.curriculum.perceptual import SlimVgg, style_distance
from styl3r_export.curriculum.pictures import PictureBank, flat_batches, training_pictures
from styl3r_export.curriculum.stylization import (
    StyleStep,
    correspondences,
    laid_over,
    style_batches,
    view_agreement,
)
from styl3r_export.curriculum.trainer import Schedule, Trainer, load_checkpoint
from styl3r_export.model import build
from styl3r_export.model.rotations import rotation_matrix
from styl3r_export.scenes.shards import Plan, write_shard
from styl3r_export.scenes.textures import TextureBank

SIZE, VIEWS, SCENES = 64, 4, 2


@pytest.fixture(scope="module")
def shards(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("shards")
    plan = Plan(seed=3, views=VIEWS, size=(SIZE, SIZE), scenes=SCENES)
    write_shard(folder, 0, plan, TextureBank.procedural(0))
    return folder


@pytest.fixture(scope="module")
def pictures(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    rng = np.random.default_rng(0)
    for i in range(12):
        pixels = rng.integers(0, 255, (90 + i, 120, 3), np.uint8)
        Image.fromarray(pixels).save(folder / f"{i:02}.png")
    return folder


def trainer(folder: Path, steps: int, trains=stages.geometry_trains) -> Trainer:
    torch.manual_seed(0)
    return Trainer(folder, Schedule(steps, warm_up=1), trains)


def test_batches_have_the_first_view_as_world(shards):
    batch = next(data.batches(shards, seed=0, size=2, views=(3,)))
    eye = torch.eye(4).expand_as(batch.extrinsics[:, 0])
    assert torch.allclose(batch.extrinsics[:, 0], eye, atol=1e-5)
    assert torch.allclose(batch.depth[:, 0].flatten(1).median(1).values, torch.ones(1), atol=1e-3)


def test_mirrored_scene_still_agrees_with_itself(shards):
    for mirrored in (False, True):
        batch = next(data.batches(shards, seed=1, size=2, views=(2,)))
        batch = data.mirror(batch) if mirrored else batch
        _, seen = correspondences(batch)
        assert seen.float().mean() > 0.1
        # Colours of one place in two photos differ by exposure and noise alone.
        assert view_agreement(batch.images, batch) < 0.15


def test_flat_scenes_agree_exactly(pictures):
    bank = PictureBank(training_pictures(pictures), 80)
    batch = next(flat_batches(bank, seed=0, scenes=3, size=64))
    assert view_agreement(batch.images, batch) < 1e-3


def test_views_laid_over_each_other_keep_what_they_agree_on(shards):
    batch = next(data.batches(shards, seed=1, size=2, views=(3,)))
    grey = torch.full_like(batch.images, 0.5)
    torch.testing.assert_close(laid_over(grey, batch), grey[:, 0])
    # Marks that only one view makes lose their share of every place that others see.
    marks = torch.randn_like(grey[:, 0])
    marked = torch.cat((grey[:, :1] + marks[:, None], grey[:, 1:]), dim=1)
    _, seen = correspondences(batch)
    share = 1 / (1 + seen.sum(dim=1, keepdim=True))
    torch.testing.assert_close(laid_over(marked, batch), grey[:, 0] + share * marks)


def test_geometry_stage_trains_resumes_and_leaves_colours_alone(shards, tmp_path):
    batches = data.batches(shards, seed=0, size=1, views=(2,))
    first = trainer(tmp_path, steps=2)
    before = {n: p.clone() for n, p in first.model.named_parameters()}
    first.run(batches, stages.geometry_step, log_every=1)
    moved = {n for n, p in first.model.named_parameters() if not torch.equal(p, before[n])}
    assert any(n.startswith("backbone.dec_blocks2.") for n in moved)
    assert not any(n.startswith(stages.APPEARANCE) for n in moved)
    second = trainer(tmp_path, steps=3)
    assert second.step == 2
    assert torch.equal(second.model.backbone.decoder_embed.weight,
                       first.model.backbone.decoder_embed.weight)  # fmt: skip
    second.run(batches, stages.geometry_step, log_every=1)
    assert load_checkpoint(tmp_path / "last.pt")["step"] == 3
    assert (tmp_path / "log.csv").read_text().count("\n") == 4


def test_checkpoints_of_a_run_can_be_exported(tmp_path):
    """Weights lie in memory as in a new network: traced graphs compare layouts."""
    trainer(tmp_path, steps=1).save()
    exported = load_any(tmp_path / "last.pt")
    assert all(parameter.is_contiguous() for parameter in exported.parameters())
    new = build("mini")
    assert [p.stride() for p in exported.parameters()] == [p.stride() for p in new.parameters()]


def test_novel_view_stage_reaches_opacities(shards, tmp_path):
    run = trainer(tmp_path, steps=1, trains=stages.novel_views_train)
    step = NovelViewStep(Blur())
    losses = step(run.model, next(data.batches(shards, seed=0, size=1, views=(3,))))
    assert {"photometric", "perceptual", "depth"} <= set(losses)
    torch.stack(list(losses.values())).sum().backward()
    assert run.model.gaussian_param_head.dpt.head[4].bias.grad.abs().max() > 0


def test_style_stage_moves_the_appearance_branch_only(shards, pictures, tmp_path):
    bank = PictureBank(training_pictures(pictures), 80)
    batches = style_batches(
        data.batches(shards, seed=0, size=1, views=(2,)), flat_batches(bank, 0, 1, SIZE), bank, 0
    )
    run = trainer(tmp_path, steps=6, trains=stages.appearance_trains)
    before = {n: p.clone() for n, p in run.model.named_parameters()}
    run.run(batches, StyleStep(Blur(), teacher=None), log_every=6)
    moved = {n for n, p in run.model.named_parameters() if not torch.equal(p, before[n])}
    assert moved
    assert all(n.startswith(stages.APPEARANCE) for n in moved)


def test_a_moved_frozen_parameter_is_an_error(tmp_path):
    run = trainer(tmp_path, steps=1, trains=stages.appearance_trains)
    with torch.no_grad():
        run.model.backbone.decoder_embed.bias.add_(1)
    with pytest.raises(AssertionError, match=r"backbone\.decoder_embed\.bias"):
        run.save()


def test_quaternions_of_rotations():
    q = torch.nn.functional.normalize(torch.tensor([[1.0, 0.2, -0.3, 0.1], [1, 0, 0, 0]]), dim=-1)
    assert torch.allclose(quaternions(rotation_matrix(q)), q, atol=1e-6)


def test_held_out_pictures_are_never_trained_on(pictures):
    names = {p.name for p in training_pictures(pictures)}
    assert "00.png" not in names
    assert "10.png" not in names
    assert len(names) == 10


def test_slim_vgg_reproduces_its_reference():
    folder = reference_folder().parent / "teachers" / "vgg19-slim16x"
    check = np.load(folder / "check.npz")
    network = SlimVgg(folder / "encoder_stage5.npz")
    features = network(torch.from_numpy(check["image"]).float())
    assert np.abs(features[3].numpy() - check["relu4_1"]).max() < 1e-4
    assert float(style_distance(features, features)) == 0
