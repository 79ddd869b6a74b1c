"""Manifests: what they promise is checked to the last bit, and damage is told in one line."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from styl3r_cli.errors import ModelError
from styl3r_cli.manifest import (
    APPEARANCE,
    MANIFEST,
    STRUCTURE,
    Manifest,
    check_file,
    describe_files,
    files_of,
    read_manifest,
    sha256_of,
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three files and their manifest."""
    for name in (STRUCTURE, APPEARANCE, f"{STRUCTURE}.data"):
        (tmp_path / name).write_bytes(name.encode() * 100)
    manifest = Manifest("mini", "1", "abc", "fp16", describe_files(tmp_path))
    (tmp_path / MANIFEST).write_text(manifest.to_json())
    return tmp_path


def rewrite(folder: Path, **changes: Any) -> None:
    path = folder / MANIFEST
    values = json.loads(path.read_text()) | changes
    path.write_text(json.dumps(values))


def test_a_manifest_comes_back_as_it_was_written(folder: Path) -> None:
    manifest = read_manifest(folder)
    assert manifest == Manifest("mini", "1", "abc", "fp16", describe_files(folder))
    assert list(manifest.files) == [APPEARANCE, STRUCTURE, f"{STRUCTURE}.data"]
    for name in manifest.files:
        check_file(folder, name, manifest)


def test_checksums_are_sha256(folder: Path) -> None:
    data = (folder / STRUCTURE).read_bytes()
    assert sha256_of(folder / STRUCTURE) == hashlib.sha256(data).hexdigest()


def test_the_weights_file_belongs_to_its_graph(folder: Path) -> None:
    manifest = read_manifest(folder)
    assert files_of(STRUCTURE, manifest) == [STRUCTURE, f"{STRUCTURE}.data"]
    assert files_of(APPEARANCE, manifest) == [APPEARANCE]


def test_one_changed_bit_is_noticed(folder: Path) -> None:
    manifest = read_manifest(folder)
    path = folder / APPEARANCE
    data = bytearray(path.read_bytes())
    data[7] ^= 1
    path.write_bytes(data)
    with pytest.raises(ModelError, match=r"appearance\.onnx: damaged"):
        check_file(folder, APPEARANCE, manifest)


def test_a_cut_and_a_missing_file_are_noticed(folder: Path) -> None:
    manifest = read_manifest(folder)
    (folder / STRUCTURE).write_bytes(b"short")
    with pytest.raises(ModelError, match=r"5 bytes instead of 1400"):
        check_file(folder, STRUCTURE, manifest)
    (folder / STRUCTURE).unlink()
    with pytest.raises(ModelError, match="missing"):
        check_file(folder, STRUCTURE, manifest)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "something"}, "not a manifest"),
        ({"format_version": 2}, "format version 2, this program reads 1"),
        ({"files": {}}, "does not list the two graphs"),
        ({"files": []}, "missing or of the wrong kind"),
        ({"files": {STRUCTURE: {"bytes": 1}}}, "missing or of the wrong kind"),
        ({"files": {STRUCTURE: {"bytes": "1", "sha256": "0"}}}, "'bytes' is no int"),
        ({"files": {STRUCTURE: {"bytes": True, "sha256": "0"}}}, "'bytes' is no int"),
        ({"files": {STRUCTURE: {"bytes": 1, "sha256": 0}}}, "'sha256' is no str"),
        ({"model": ["mini"]}, "'model' is no str"),
        ({"model_version": 3}, "'model_version' is no str"),
        ({"precision": None}, "'precision' is no str"),
        ({"weights_id": {}}, "'weights_id' is no str"),
    ],
)
def test_a_damaged_manifest_is_told_in_one_line(
    folder: Path, changes: dict[str, Any], message: str
) -> None:
    rewrite(folder, **changes)
    with pytest.raises(ModelError, match=message) as caught:
        read_manifest(folder)
    assert "\n" not in str(caught.value)
    assert MANIFEST in str(caught.value)


def test_files_outside_of_the_folder_are_refused(folder: Path) -> None:
    files = json.loads((folder / MANIFEST).read_text())["files"]
    rewrite(folder, files=files | {"../elsewhere": {"bytes": 1, "sha256": "0"}})
    with pytest.raises(ModelError, match="does not list"):
        read_manifest(folder)


@pytest.mark.parametrize("content", ["", "[1]", "{", "\x00\xff"])
def test_other_contents_are_refused(folder: Path, content: str) -> None:
    (folder / MANIFEST).write_text(content, encoding="latin-1")
    with pytest.raises(ModelError, match=MANIFEST):
        read_manifest(folder)


def test_a_folder_without_a_manifest_is_no_model(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="a model is a folder that `styl3r export` wrote"):
        read_manifest(tmp_path)


def test_what_a_manifest_says_is_not_recited(folder: Path) -> None:
    rewrite(folder, format_version="x" * 100_000)
    with pytest.raises(ModelError) as caught:
        read_manifest(folder)
    assert len(str(caught.value)) < 400 + len(str(folder))


def test_a_manifest_of_any_size_takes_no_memory(folder: Path) -> None:
    with (folder / MANIFEST).open("r+b") as file:
        file.truncate(1 << 40)  # a hole
    with pytest.raises(ModelError, match="too large"):
        read_manifest(folder)
