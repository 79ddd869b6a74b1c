"""Arguments to photo files: order, skipped files, and errors that say what was not found."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from styl3r_cli.errors import InputError
from styl3r_cli.photos.expand import expand
from styl3r_cli.photos.listing import parse_list


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ["img10.jpg", "img2.JPG", "IMG1.png", "é 3.webp", ".DS_Store", ".x.jpg", "a.txt"]:
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / "sub.jpg").mkdir()
    return tmp_path


def names(paths: list[Path]) -> list[str]:
    return [path.name for path in paths]


def test_folder_is_sorted_as_people_count(folder: Path) -> None:
    notes: list[str] = []
    assert names(expand([str(folder)], notes)) == ["IMG1.png", "img2.JPG", "img10.jpg", "é 3.webp"]
    assert notes == [f"{folder}: skipped a.txt (no photos)"]


def test_glob_and_files_keep_the_order_of_the_arguments(folder: Path) -> None:
    last = str(folder / "img10.jpg")
    assert names(expand([last, str(folder / "[iI]*")])) == ["img10.jpg", "IMG1.png", "img2.JPG"]


def test_files_are_taken_whatever_they_are_called(folder: Path) -> None:
    assert names(expand([str(folder / "a.txt"), str(folder / ".x.jpg")])) == ["a.txt", ".x.jpg"]


def test_file_with_glob_characters_in_its_name(folder: Path) -> None:
    (folder / "a[1].jpg").write_bytes(b"x")
    assert names(expand([str(folder / "a[1].jpg")])) == ["a[1].jpg"]


@pytest.fixture
def deep(tmp_path: Path) -> Path:
    """Photos in folders in folders, and links that go round: 2^40 ways to the same photo."""
    for name in ("top.jpg", "a/one.jpg", "a/b/two.jpg", "a/b/note.txt", ".hidden/three.jpg"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"x")
    for name in ("round", "a/again", "a/b/back"):
        (tmp_path / name).symlink_to(tmp_path, target_is_directory=True)
    return tmp_path


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")
@pytest.mark.parametrize(
    ("pattern", "expected"),
    [
        ("**", ["one.jpg", "two.jpg", "top.jpg"]),
        ("**/*.jpg", ["one.jpg", "two.jpg", "top.jpg"]),
        ("**/t**.jpg", ["two.jpg", "top.jpg"]),
        ("a/**/*", ["one.jpg", "two.jpg"]),
        ("[a]/**/two.jpg", ["two.jpg"]),
    ],
)
def test_globs_of_any_depth_end(
    deep: Path, pattern: str, expected: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = expand([str(deep / pattern)])
    assert sorted(names(found)) == sorted(expected)
    monkeypatch.chdir(deep)
    assert [path.absolute() for path in expand([pattern])] == found


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("gone.jpg", "gone.jpg: no such file or folder"),
        ("nowhere/gone.jpg", r"there is no folder .*nowhere"),
        ("*.tiff", "no photo matches this pattern"),
        ("**/*.tiff", "no photo matches this pattern"),
        ("sub.jpg", "no photos in this folder"),
    ],
)
def test_missing_things_are_named(folder: Path, argument: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        expand([str(folder / argument)])


def test_a_list_stands_where_it_is_named_and_is_taken_literally(folder: Path) -> None:
    odd = folder / "[a]*.jpg"
    odd.write_bytes(b"x")
    listed = [str(folder / "img10.jpg"), str(odd), str(folder / "img2.JPG")]
    arguments = [str(folder / "IMG1.png"), "-", str(folder / "a.txt")]
    assert names(expand(arguments, listed=listed)) == [
        "IMG1.png",
        "img10.jpg",
        "[a]*.jpg",
        "img2.JPG",
        "a.txt",
    ]
    with pytest.raises(InputError, match=r"gone\*\.jpg: no such file"):
        expand(["-"], listed=[str(folder / "gone*.jpg")])


@pytest.mark.parametrize(
    ("data", "null", "expected"),
    [
        (b"a.jpg\nb c.jpg\n", False, ["a.jpg", "b c.jpg"]),
        (b"a.jpg\r\n\r\nb.jpg", False, ["a.jpg", "b.jpg"]),
        (b"a\nb.jpg\0c.jpg\0", True, ["a\nb.jpg", "c.jpg"]),
        (b"a ", False, ["a "]),
        ("é.jpg\n".encode(), False, ["é.jpg"]),
        ("é.jpg\r\n".encode("utf-8-sig"), False, ["é.jpg"]),
        ("é.jpg\r\nb.jpg\r\n".encode("utf-16"), False, ["é.jpg", "b.jpg"]),
    ],
)
def test_lists_of_names(data: bytes, null: bool, expected: list[str]) -> None:
    assert parse_list(data, null) == expected


def test_names_that_are_no_unicode_are_still_names() -> None:
    (name,) = parse_list(b"\xff.jpg\n")
    assert os.fsencode(name) == b"\xff.jpg"


@pytest.mark.parametrize(("data", "words"), [(b"\n\n", "no photo names"), (b"a\0b\0", "add -0")])
def test_lists_that_are_none(data: bytes, words: str) -> None:
    with pytest.raises(InputError, match=words):
        parse_list(data)
