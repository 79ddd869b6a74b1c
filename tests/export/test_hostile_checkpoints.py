"""Checkpoints that are hostile, damaged or lie: nothing is executed, each is refused."""

from __future__ import annotations

import builtins
import os
import pickle
import sys
import tracemalloc
import types
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from small_checkpoints import TINY, assert_same, lightning, saved
from torch import Tensor, nn

from styl3r_cli.errors import InputError
from styl3r_export.checkpoints import CheckpointError, load_any, load_own, load_published
from styl3r_export.model import ModelConfig, Styl3r
from styl3r_export.model.config import CONFIGS
from styl3r_export.safe_pickle import InertUnpickler, read_checkpoint


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
