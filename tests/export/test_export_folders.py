"""Where an exported model goes: folders that are replaced as a whole, links, and what is kept."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from styl3r_cli import manifest as manifests
from styl3r_cli.errors import OutputError
from styl3r_cli.manifest import APPEARANCE, MANIFEST, STRUCTURE, Manifest
from styl3r_export.quantise.folders import check_target, replacing

NOBODY = 65534


def write_export(folder: Path, text: str) -> None:
    """What an export leaves, but for graphs that are none."""
    folder.mkdir(exist_ok=True)
    for name in (STRUCTURE, APPEARANCE):
        (folder / name).write_text(text)
    manifest = Manifest("mini", "1", "abc", "fp32", manifests.describe_files(folder))
    (folder / MANIFEST).write_text(manifest.to_json())


@pytest.mark.parametrize("before", ["an export", "an empty folder", "nothing"])
def test_a_link_keeps_pointing_where_it_points(tmp_path: Path, before: str) -> None:
    real, link = tmp_path / "disk" / "real", tmp_path / "link"
    real.parent.mkdir()
    if before != "nothing":
        real.mkdir()
    if before == "an export":
        write_export(real, "old")
    link.symlink_to(real)
    with replacing(link) as temporary:
        write_export(temporary, "new")
    assert link.is_symlink()
    assert (real / STRUCTURE).read_text() == "new"
    assert {path.name for path in tmp_path.iterdir()} == {"disk", "link"}
    assert [path.name for path in real.parent.iterdir()] == ["real"]


def test_a_folder_in_the_place_of_a_graph_is_kept(tmp_path: Path) -> None:
    write_export(tmp_path, "old")
    (tmp_path / STRUCTURE).unlink()
    (tmp_path / STRUCTURE).mkdir()
    with pytest.raises(OutputError, match="holds something else"):
        check_target(tmp_path)


def test_the_current_folder_is_not_taken_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in (Path(), tmp_path):
        with pytest.raises(OutputError, match="is the current folder"):
            check_target(name)


@pytest.fixture
def place() -> Iterator[Path]:
    """A folder that others may get to; pytest's own may only be entered by who runs it."""
    if not hasattr(os, "fork"):
        pytest.skip("no fork")
    with tempfile.TemporaryDirectory() as name:
        if os.geteuid() == 0:
            os.chown(name, NOBODY, NOBODY)
        yield Path(name)


def outcome(folder: Path, umask: int = 0o022) -> str:
    """What writing an export into a folder says to a user who is not the superuser."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        said = "a bug"
        try:
            if os.geteuid() == 0:
                os.setgroups([])
                os.setgid(NOBODY)
                os.setuid(NOBODY)
            os.umask(umask)
            try:
                with replacing(folder) as temporary:
                    write_export(temporary, "new")
                said = "done"
            except OutputError as error:
                said = str(error)
        finally:
            os.write(write, said.encode())
            os._exit(0)
    os.close(write)
    with os.fdopen(read) as pipe:
        said = pipe.read()
    os.waitpid(child, 0)
    return said


def test_what_may_not_be_read_or_written_is_left_alone(place: Path) -> None:
    folder = place / "model"
    write_export(folder, "old")
    if os.geteuid() == 0:
        os.chown(folder, NOBODY, NOBODY)
    for mode, message in ((0o000, "Permission denied"), (0o555, "write-protected")):
        folder.chmod(mode)
        assert message in outcome(folder)
        folder.chmod(0o755)
        assert [path.name for path in place.iterdir()] == ["model"]
        assert (folder / STRUCTURE).read_text() == "old"
    assert outcome(folder) == "done"


def test_a_umask_that_forbids_everything_leaves_nothing_behind(place: Path) -> None:
    assert "Permission denied" in outcome(place / "model", umask=0o777)
    assert list(place.iterdir()) == []
