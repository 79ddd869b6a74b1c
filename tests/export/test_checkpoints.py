"""Checkpoints of all kinds: complete or refused, and what initialises what."""

from __future__ import annotations

import types
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from shared_reference import state_entries
from small_checkpoints import TINY, assert_same, lightning, saved
from torch import Tensor

from styl3r_cli.errors import InputError
from styl3r_export.checkpoints import CheckpointError, load_any, load_own, load_published
from styl3r_export.initialise import initialise_from_mast3r, initialise_from_noposplat
from styl3r_export.model import Styl3r, build

ALIASED = "gaussian_appearance_head.dpt.scratch.layer2_rn.weight"
WINNER = "gaussian_appearance_head.dpt.scratch.layer_rn.1.weight"


# ---------------------------------------------------------------------- published


def test_a_published_checkpoint_loads_completely(tiny: Styl3r, tmp_path: Path) -> None:
    content = lightning(tiny)
    content["state_dict"]["losses.lpips.weight"] = torch.zeros(3)
    model, report = load_published(saved(tmp_path / "a.ckpt", content))
    assert_same(model, tiny)
    assert report.complete
    assert report.dropped == ["losses.lpips.weight"]
    assert set(report.loaded) == set(tiny.state_dict())
    assert not model.training


def test_what_is_missing_and_unexpected_is_listed(tiny: Styl3r, tmp_path: Path) -> None:
    content = lightning(tiny)
    state = content["state_dict"]
    del state["encoder.backbone.enc_norm.weight"]
    state["encoder.backbone.surprise"] = torch.zeros(1)
    state["encoder.backbone.dec_norm.bias"] = torch.zeros(5)
    with pytest.raises(CheckpointError) as caught:
        load_published(saved(tmp_path / "a.ckpt", content))
    message, report = str(caught.value), caught.value.report
    assert "1 missing: backbone.enc_norm.weight" in message
    assert "1 unexpected: backbone.surprise" in message
    assert "backbone.dec_norm.bias (5,) instead of (8,)" in message
    assert "\n" not in message
    assert report.missing == ["backbone.enc_norm.weight"]
    assert report.unexpected == ["backbone.surprise"]


def test_a_long_list_is_cut_in_the_message_but_not_in_the_report(
    tiny: Styl3r, tmp_path: Path
) -> None:
    content = lightning(tiny)
    content["state_dict"] = {
        n: v for n, v in content["state_dict"].items() if "token_stylizer" not in n
    }
    lost = {n for n in tiny.state_dict() if n.startswith("token_stylizer")}
    with pytest.raises(CheckpointError, match=f"and {len(lost) - 6} more") as caught:
        load_published(saved(tmp_path / "a.ckpt", content))
    assert set(caught.value.report.missing) == lost
    assert len(str(caught.value)) < 600


def test_the_list_name_wins_where_aliases_differ(tiny: Styl3r, tmp_path: Path) -> None:
    content = lightning(tiny)
    state = content["state_dict"]
    state[f"encoder.{WINNER}"] = torch.full_like(state[f"encoder.{WINNER}"], 7)
    model, report = load_published(saved(tmp_path / "a.ckpt", content))
    assert report.differing_aliases == [ALIASED]
    assert bool((model.get_parameter(ALIASED) == 7).all())
    assert model.get_parameter(ALIASED) is model.get_parameter(WINNER)


def test_half_precision_checkpoints_become_float32(tiny: Styl3r, tmp_path: Path) -> None:
    content = lightning(tiny)
    content["state_dict"] = {n: v.half() for n, v in content["state_dict"].items()}
    model, _ = load_published(saved(tmp_path / "a.ckpt", content))
    assert {p.dtype for p in model.parameters()} == {torch.float32}
    assert_same(model, tiny.half().float())


def test_a_loaded_model_can_be_trained(tiny: Styl3r, tmp_path: Path) -> None:
    model, _ = load_published(saved(tmp_path / "a.ckpt", lightning(tiny)))
    assert all(p.requires_grad for p in model.parameters())
    with torch.no_grad():
        model.get_parameter("backbone.enc_norm.weight").add_(1)  # the file's memory is private


# ---------------------------------------------------------------------- unsafe files


def test_a_missing_file_and_another_layout_are_refused(tiny: Styl3r, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_published(tmp_path / "none.ckpt")
    for content in ({"model": tiny.state_dict()}, [1, 2], torch.ones(2)):
        with pytest.raises(InputError, match="state_dict"):
            load_published(saved(tmp_path / "a.ckpt", content))


# ---------------------------------------------------------------------- our own


def test_own_checkpoints_come_back(tmp_path: Path) -> None:
    model = build(replace(TINY, name="small"))
    content = {"config": model.config.to_dict(), "model": model.state_dict(), "step": 7}
    path = saved(tmp_path / "last.pt", content)
    for load in (load_own, load_any):
        again = load(path)
        assert_same(again, model)
        assert again.config == model.config


def test_any_checkpoint_is_recognised(tiny: Styl3r, tmp_path: Path) -> None:
    assert_same(load_any(saved(tmp_path / "a.ckpt", lightning(tiny))), tiny)


def test_own_checkpoints_of_another_version_are_refused(tmp_path: Path) -> None:
    model = build(TINY)
    config = model.config.to_dict()
    strange = {"config": config | {"strange": 1}, "model": model.state_dict()}
    with pytest.raises(InputError, match="strange"):
        load_own(saved(tmp_path / "a.pt", strange))
    larger = {"config": config | {"encoder_depth": 3}, "model": model.state_dict()}
    with pytest.raises(CheckpointError, match=r"backbone\.enc_blocks\.2"):
        load_own(saved(tmp_path / "b.pt", larger))


# ---------------------------------------------------------------------- initialisation


def mast3r_like(model: Styl3r) -> dict[str, Tensor]:
    """Entries named and shaped as MASt3R's, for the sizes of a model."""
    torch.manual_seed(5)
    entries = {}
    for name, value in model.backbone.state_dict().items():
        if "intrinsic_encoder" not in name:
            entries[name] = torch.randn_like(value)
    for name, value in model.state_dict().items():
        if name.startswith("downstream_head"):
            entries[name] = torch.randn_like(value)
            if ".head.4." in name:
                entries[name] = torch.randn(4, *value.shape[1:])  # x, y, z, confidence
    entries["downstream_head1.head_local_features.fc1.weight"] = torch.randn(3, 3)
    return entries


def test_mast3r_starts_backbone_heads_and_stylizer(tmp_path: Path) -> None:
    model = build(TINY)
    before = {n: v.clone() for n, v in model.state_dict().items()}
    entries = mast3r_like(model)
    path = saved(tmp_path / "mast3r.pth", {"model": entries, "args": types.SimpleNamespace(a=1)})
    report = initialise_from_mast3r(model, path)
    after = model.state_dict()
    for name, value in entries.items():
        if name.startswith("downstream_head"):
            continue
        assert torch.equal(after[f"backbone.{name}"], value), name
        if not name.startswith("dec_blocks2") and f"token_stylizer.{name}" in after:
            assert torch.equal(after[f"token_stylizer.{name}"], value), name
    last = "downstream_head2.dpt.head.4.weight"
    assert torch.equal(after[last], entries[last][:3])
    untouched = set(report.untouched)
    assert all(torch.equal(after[n], before[n]) for n in untouched)
    assert {n.split(".")[0] for n in untouched} == {
        "backbone",  # its intrinsic encoder
        "gaussian_param_head",
        "gaussian_param_head2",
        "gaussian_appearance_head",
    }
    assert {n for n in untouched if n.startswith("backbone")} == {
        "backbone.intrinsic_encoder.weight",
        "backbone.intrinsic_encoder.bias",
    }
    assert report.ignored == ["downstream_head1.head_local_features.fc1.weight"]
    assert untouched | set(report.loaded) == set(after)
    assert "head_local_features" in report.summary()
    assert "gaussian_param_head" in report.summary()


def test_the_published_network_has_every_name_that_mast3r_would_fill() -> None:
    """MASt3R's transformer names are the published ones without `backbone.`."""
    names = {e["name"] for e in state_entries()}
    for part in ("patch_embed.proj.weight", "enc_blocks.23.mlp.fc2.bias", "dec_norm.weight"):
        assert f"backbone.{part}" in names
        assert f"token_stylizer.{part}" in names
    assert "backbone.dec_blocks2.11.cross_attn.projv.weight" in names


def test_noposplat_starts_what_has_the_same_name(tmp_path: Path) -> None:
    model = build(TINY)
    before = {n: v.clone() for n, v in model.state_dict().items()}
    torch.manual_seed(6)
    entries = {}
    for name, value in model.state_dict().items():
        if name.startswith(("backbone", "downstream_head", "gaussian_param_head")):
            entries[f"encoder.{name}"] = torch.randn_like(value)
    last = "gaussian_param_head.dpt.head.4.weight"
    wider = torch.randn(83, *model.state_dict()[last].shape[1:])  # colours of degree 4 follow
    entries[f"encoder.{last}"] = wider
    entries["encoder.backbone.enc_norm.bias"] = torch.randn(99)
    entries["decoder.something"] = torch.randn(1)
    report = initialise_from_noposplat(model, saved(tmp_path / "n.ckpt", {"state_dict": entries}))
    after = model.state_dict()
    assert torch.equal(after[last], wider[:8])
    assert torch.equal(after["backbone.enc_norm.bias"], before["backbone.enc_norm.bias"])
    assert report.ignored == ["decoder.something", "encoder.backbone.enc_norm.bias"]
    modules = {n.split(".")[0] for n in report.untouched}
    assert modules == {"token_stylizer", "gaussian_appearance_head", "backbone"}
    assert "backbone.enc_norm.bias" in report.untouched


def test_a_checkpoint_that_fits_nowhere_is_refused(tmp_path: Path) -> None:
    model = build(TINY)
    with pytest.raises(InputError, match="nothing in it fits"):
        initialise_from_mast3r(model, saved(tmp_path / "a.pth", {"model": {"x": torch.ones(1)}}))
    with pytest.raises(InputError, match="has no 'model'"):
        initialise_from_mast3r(model, saved(tmp_path / "b.pth", {"state_dict": {}}))


def test_mini_takes_what_fits_and_keeps_the_rest(tmp_path: Path) -> None:
    mini, donor = build("mini"), build(TINY)
    entries = donor.backbone.state_dict() | {"enc_norm.weight": torch.full((192,), 3.0)}
    report = initialise_from_mast3r(mini, saved(tmp_path / "a.pth", {"model": entries}))
    assert report.loaded == ["backbone.enc_norm.weight"]
    assert bool((mini.get_parameter("backbone.enc_norm.weight") == 3).all())
