"""The curve beside other methods: what it prints, and how it refuses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from layered_scene import layered_scene, views

from styl3r_cli.cameras.stored import cameras_to_metadata
from styl3r_cli.formats import write_scene
from styl3r_export.evaluate.compaction_curve import main


def refused(arguments: Sequence[object], capsys: pytest.CaptureFixture[str]) -> str:
    """The last line on standard error."""
    with pytest.raises(SystemExit) as ended:
        main([str(each) for each in arguments])
    assert ended.value.code in (2, 3)
    return capsys.readouterr().err.splitlines()[-1]


def test_a_missing_scene_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "Error: " in refused([tmp_path / "gone.ply"], capsys)


@pytest.mark.parametrize("share", ["nan", "0", "-1", "1.5", "inf", "half"])
def test_shares_that_are_none_are_refused(
    share: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refused([tmp_path / "gone.ply", "--shares", share], capsys)
    assert f"--shares: {share} " in line or "invalid" in line


def test_a_program_that_is_not_there_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_scene(tmp_path / "s.ply", layered_scene(), cameras_to_metadata(views()))
    options = ["--shares", "0.5", "--methods", "random", "--splat-transform", "no_program"]
    assert "--splat-transform: " in refused([tmp_path / "s.ply", *options], capsys)
