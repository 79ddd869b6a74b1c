"""The README tells the truth: its Python runs, and it names what there is."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from styl3r_cli import graphs
from styl3r_cli.errors import ExitCode
from styl3r_cli.formats import read_scene
from styl3r_cli.main import COMMANDS

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def readme() -> str:
    return (ROOT / "README.md").read_text(encoding="utf-8")


def test_its_python_runs(
    readme: str, tiny_model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    shutil.copytree(tiny_model, tmp_path / "models" / "mini")
    monkeypatch.setattr(graphs, "BUNDLED", tmp_path / "models")
    monkeypatch.chdir(tmp_path)
    [program] = re.findall(r"^```python\n(.*?)^```$", readme, re.DOTALL | re.MULTILINE)
    exec(compile(program, "README.md", "exec"), {})
    scenes = [read_scene(tmp_path / f"{name}.ply").gaussians for name in ("night", "wave")]
    assert (scenes[0].means == scenes[1].means).all()
    assert (scenes[0].colours != scenes[1].colours).any()


def test_it_names_every_command_and_exit_code(readme: str) -> None:
    assert re.findall(r"^\| `styl3r (\w+) ", readme, re.MULTILINE) == list(COMMANDS)
    [codes] = re.findall(r"^Exit codes: (.*?)\.", readme, re.DOTALL | re.MULTILINE)
    assert [int(n) for n in re.findall(r"\d+", codes)] == sorted(ExitCode)


def test_the_files_it_links_exist(readme: str) -> None:
    links = re.findall(r"\]\((?!https?://)([^)#]+)\)", readme)
    assert "LICENSE" in links
    missing = [link for link in links if not (ROOT / link).exists()]
    assert missing == []
