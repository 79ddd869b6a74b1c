"""Checkpoints of all kinds: read as data only, complete or refused, and what initialises what."""

from __future__ import annotations

import builtins
import os
import pickle
import sys
import tracemalloc
import types
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from shared_reference import state_entries
from torch import Tensor, nn

from styl3r_cli.errors import InputError
from styl3r_export import checkpoints
from styl3r_export.checkpoints import CheckpointError, load_any, load_own, load_published
from styl3r_export.initialise import initialise_from_mast3r, initialise_from_noposplat
from styl3r_export.model import FULL, ModelConfig, Styl3r, build
from styl3r_export.model.config import CONFIGS
from styl3r_export.safe_pickle import InertUnpickler, read_checkpoint

TINY = replace(
    FULL,
    head_dim=8,
    encoder_dim=16,
    encoder_depth=2,
    style_depth=1,
    decoder_dim=8,
    decoder_depth=3,
    stylizer_depth=3,
    hooks=(1, 2, 3),
    head_maps=(3, 4, 5, 6),
    head_features=4,
    point_features=4,
)
ALIASED = "gaussian_appearance_head.dpt.scratch.layer2_rn.weight"
WINNER = "gaussian_appearance_head.dpt.scratch.layer_rn.1.weight"


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> Styl3r:
    """A model of the published layout, small; loaders take its sizes for the published ones."""
    monkeypatch.setattr(checkpoints, "FULL", TINY)
    torch.manual_seed(0)
    return build(TINY)


def lightning(model: nn.Module) -> dict[str, Any]:
    """A Lightning file's contents."""
    state = OrderedDict((f"encoder.{n}", v) for n, v in model.state_dict().items())
    return {"epoch": 3, "global_step": 35000, "state_dict": state}


def saved(path: Path, content: object) -> Path:
    torch.save(content, path)
    return path


def assert_same(a: nn.Module, b: nn.Module) -> None:
    ours, theirs = a.state_dict(), b.state_dict()
    assert ours.keys() == theirs.keys()
    assert all(torch.equal(ours[n], theirs[n]) for n in ours)


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


class Evil:
    """Pickles to a call that would create a file."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.target),)


def test_nothing_in_a_pickle_is_executed(tiny: Styl3r, tmp_path: Path) -> None:
    target = tmp_path / "executed"
    content = lightning(tiny) | {"hyper_parameters": {"x": Evil(target)}}
    path = saved(tmp_path / "evil.ckpt", content)
    model, _ = load_published(path)
    assert_same(model, tiny)
    assert not target.exists()
    torch.load(path, weights_only=False)  # the file does what the test believes it does
    assert target.exists()


@pytest.mark.parametrize("call", ["eval", "exec", "getattr", "__import__"])
def test_builtins_are_not_called_either(tmp_path: Path, call: str) -> None:
    target = tmp_path / "executed"

    class Sneaky:
        def __reduce__(self) -> tuple[Any, ...]:
            code = f"__import__('os').mkdir({str(target)!r})"
            arguments = {"getattr": ("text", "upper"), "__import__": ("os",)}
            return getattr(builtins, call), arguments.get(call, (code,))

    content = read_checkpoint(saved(tmp_path / "a.ckpt", {"x": Sneaky(), "y": torch.ones(2)}))
    assert type(content["x"]).__bases__[0].__name__ == "Placeholder"
    assert torch.equal(content["y"], torch.ones(2))
    assert not target.exists()


def test_a_claim_to_remember_much_takes_no_memory(tmp_path: Path) -> None:
    """Five bytes that number an object 100 million: a table of as many took gigabytes."""
    content = pickle.PROTO + b"\x02" + pickle.EMPTY_DICT
    content += pickle.LONG_BINPUT + (10**8).to_bytes(4, "little") + pickle.STOP
    assert unpickled_in_little_memory(content, tmp_path) == {}


def test_a_claim_to_hold_many_bytes_takes_no_memory(tmp_path: Path) -> None:
    """Nine bytes that announce an array: one of as many zeros took gigabytes. Found by fuzzing."""
    head = pickle.PROTO + b"\x05" + pickle.BYTEARRAY8
    whole = head + (3).to_bytes(8, "little") + b"abc" + pickle.STOP
    assert unpickled_in_little_memory(whole, tmp_path) == bytearray(b"abc")
    with pytest.raises(EOFError):
        unpickled_in_little_memory(head + (10**9).to_bytes(8, "little") + b"abc", tmp_path)


def unpickled_in_little_memory(content: bytes, tmp_path: Path) -> object:
    with zipfile.ZipFile(tmp_path / "a.ckpt", "w") as archive:
        archive.writestr("a/data.pkl", content)
    with zipfile.ZipFile(tmp_path / "a.ckpt") as archive:
        tracemalloc.start()
        try:
            return InertUnpickler(archive, "a/").load()
        finally:
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            assert peak < 1e7


def test_a_state_dict_entry_that_is_an_object_is_refused(tiny: Styl3r, tmp_path: Path) -> None:
    content = lightning(tiny)
    content["state_dict"]["encoder.backbone.enc_norm.weight"] = Evil(tmp_path / "executed")
    with pytest.raises(CheckpointError, match=r"1 unexpected: backbone\.enc_norm\.weight"):
        load_published(saved(tmp_path / "a.ckpt", content))
    assert not (tmp_path / "executed").exists()


def foreign_module(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Classes like a configuration library's, which the reader's machine does not have."""
    module = types.ModuleType("omegaconf_like")
    source = """
class AnyNode:
    def __init__(self, value): self.value = value
class DictConfig(dict):
    def __init__(self, content, parent=None):
        super().__init__(content); self.parent = parent
    def __setstate__(self, state): self.__dict__.update(state)
class ListConfig(list): pass
class Callback:
    __slots__ = ("best",)
    def __init__(self): self.best = 1.5
    def __getstate__(self): return (None, {"best": self.best})
    def method(self): return 1
"""
    exec(source, module.__dict__)
    for thing in vars(module).values():
        if isinstance(thing, type):
            thing.__module__ = "omegaconf_like"
    monkeypatch.setitem(sys.modules, "omegaconf_like", module)
    return module


def test_foreign_objects_beside_the_weights_do_no_harm(
    tiny: Styl3r, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    m = foreign_module(monkeypatch)
    shared = m.AnyNode(3)
    extras = {
        "hyper_parameters": m.DictConfig({"lr": shared, "list": m.ListConfig([shared, 2])}),
        "callbacks": {m.Callback: {"state": m.Callback()}, "bound": m.Callback().method},
        "numpy": np.float64(0.5),
        "array": np.arange(3),
        "path": tmp_path,
        "device": torch.device("cpu"),
        "dtype": torch.float16,
        "size": torch.Size([1, 2]),
        "set": {1, 2},
    }
    path = saved(tmp_path / "a.ckpt", lightning(tiny) | extras)
    monkeypatch.delitem(sys.modules, "omegaconf_like")
    with pytest.raises(pickle.UnpicklingError):
        torch.load(path, weights_only=True)  # the restricted reader is really needed
    model, _ = load_published(path)
    assert_same(model, tiny)


def test_the_restricted_reader_gives_the_same_tensors_as_torch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    m = foreign_module(monkeypatch)
    base = torch.arange(24, dtype=torch.float32)
    tensors = {
        "view": base[4:16].view(3, 4).T,
        "shared": base,
        "empty": torch.empty(0, 3),
        "scalar": torch.tensor(1.5, dtype=torch.float64),
        "bool": torch.tensor([True, False]),
        "bfloat16": torch.randn(3).bfloat16(),
        "int": torch.tensor([[1, -2]], dtype=torch.int8),
        "parameter": nn.Parameter(torch.randn(2, 2)),
    }
    plain = saved(tmp_path / "plain.pt", tensors)
    mixed = saved(tmp_path / "mixed.pt", tensors | {"foreign": m.AnyNode(1)})
    expected, found = torch.load(plain, weights_only=True), read_checkpoint(mixed)
    for name, value in expected.items():
        assert found[name].dtype == value.dtype, name
        assert torch.equal(found[name], value), name
    found["shared"][5] = 100
    assert found["view"][1, 0] == 100  # one storage, as in the file


SEVERAL_DISKS = b"PK\6\7" + b"\0" * 12 + b"\2\0\0\0" + b"PK\5\6" + b"\0" * 18  # found by fuzzing


@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04 not a zip", b"text", b"\x80\x04N.", SEVERAL_DISKS]
)
def test_other_files_are_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.ckpt"
    path.write_bytes(content)
    for load in (load_published, load_own, load_any):
        with pytest.raises(InputError) as caught:
            load(path)
        assert "\n" not in str(caught.value)


def test_what_a_damaged_file_holds_is_not_recited(tiny: Styl3r, tmp_path: Path) -> None:
    """Messages of zipfile quote a name of up to 65535 bytes. Found by fuzzing."""
    path = saved(tmp_path / "a.ckpt", lightning(tiny))
    data = bytearray(path.read_bytes())
    data[26:28] = (40_000).to_bytes(2, "little")  # the length of the first name
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_checkpoint(path)
    assert len(str(caught.value)) < 300 + len(str(path))


def test_a_truncated_file_is_refused(tiny: Styl3r, tmp_path: Path) -> None:
    path = saved(tmp_path / "a.ckpt", lightning(tiny))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(InputError, match=r"a\.ckpt"):
        load_published(path)


@pytest.mark.parametrize(
    "lie",
    [
        {"encoder_dim": -32},
        {"encoder_dim": "32"},
        {"encoder_dim": 32.0},
        {"encoder_dim": None},
        {"encoder_dim": 10**12},
        {"encoder_depth": 10**9},
        {"encoder_depth": True},
        {"head_dim": 0},
        {"head_dim": 6, "encoder_dim": 12, "decoder_dim": 12},
        {"mlp_ratio": 4.5},
        {"hooks": (1,)},
        {"hooks": (1, 2, 300)},
        {"hooks": (1, 1, 2)},
        {"stylizer_depth": 1},
        {"head_maps": (3, 4)},
        {"point_features": -2},
        {"name": "two\nlines"},
        {"name": "../elsewhere"},
        {"stem": "x"},
        {"points": ["rays"]},
        {"smooth_strokes": "no"},
        {"x" * 5000: 1},
    ],
)
def test_configurations_that_lie_are_refused_in_one_short_line(
    tmp_path: Path, lie: dict[str, Any]
) -> None:
    content = {"config": TINY.to_dict() | lie, "model": {}}
    with pytest.raises(InputError) as caught:
        load_own(saved(tmp_path / "a.ckpt", content))
    message = str(caught.value)
    assert "or of another version" in message
    assert "\n" not in message
    assert len(message) < 400 + len(str(tmp_path))


def test_every_size_of_ours_is_a_possible_one() -> None:
    for config in (*CONFIGS.values(), TINY):
        assert ModelConfig.from_dict(config.to_dict()) == config


@pytest.mark.parametrize(
    "of",
    [
        lambda weight: weight.to_sparse(),
        lambda weight: weight.to_sparse_csr(),
        lambda weight: torch.quantize_per_tensor(weight, 0.1, 0, torch.qint8),
        lambda weight: weight.to("meta"),
        lambda weight: weight.to(torch.complex64) * 1j,
        lambda weight: weight.byte(),
        lambda weight: torch.nested.nested_tensor([weight[0], weight[1]]),
    ],
)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_tensors_that_are_no_plain_numbers_are_refused(
    tiny: Styl3r, tmp_path: Path, of: Callable[[Tensor], Tensor]
) -> None:
    content, name = lightning(tiny), "backbone.decoder_embed.weight"
    state = content["state_dict"]
    state[f"encoder.{name}"] = of(state[f"encoder.{name}"].detach())
    with pytest.raises(CheckpointError, match=f"1 no floating-point numbers: {name}"):
        load_published(saved(tmp_path / "a.ckpt", content))


def rewritten(path: Path, compression: int, **parts: bytes) -> None:
    """The archive again, some of its parts replaced."""
    with zipfile.ZipFile(path) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, data in content.items():
            archive.writestr(name, parts.get(name.rpartition("/")[2], data))


def test_compressed_archives_are_refused_whatever_they_grow_to(
    tiny: Styl3r, tmp_path: Path
) -> None:
    """Torch maps them into memory as they are; one of a few kilobytes can hold gigabytes."""
    path = saved(tmp_path / "a.ckpt", lightning(tiny))
    rewritten(path, zipfile.ZIP_DEFLATED)
    with pytest.raises(InputError, match="its parts are compressed"):
        read_checkpoint(path)


def test_archives_whose_parts_overlap_are_refused(tiny: Styl3r, tmp_path: Path) -> None:
    path = saved(tmp_path / "a.ckpt", lightning(tiny))
    with zipfile.ZipFile(path, "a") as archive:
        largest = max(archive.filelist, key=lambda part: part.file_size)
        archive.filelist.extend([largest] * 1000)
        archive.writestr("last", b"")  # so that the directory is written
    with pytest.raises(InputError, match="larger than the file"):
        read_checkpoint(path)


def test_the_other_order_of_bytes_is_refused(tiny: Styl3r, tmp_path: Path) -> None:
    path = saved(tmp_path / "a.ckpt", lightning(tiny))
    rewritten(path, zipfile.ZIP_STORED, byteorder=b"big")
    with pytest.raises(InputError, match="another order of bytes"):
        read_checkpoint(path)


def test_a_changed_bit_of_a_weight_is_noticed(tiny: Styl3r, tmp_path: Path) -> None:
    path = saved(tmp_path / "a.ckpt", lightning(tiny))
    weight = tiny.get_parameter("backbone.decoder_embed.weight").detach().numpy().tobytes()
    data = bytearray(path.read_bytes())
    data[data.index(weight) + 5] ^= 1
    path.write_bytes(data)
    with pytest.raises(InputError, match="checksum"):
        read_checkpoint(path)


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
