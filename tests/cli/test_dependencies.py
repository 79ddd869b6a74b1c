"""docs/dependencies.md names what pyproject.toml installs, and nothing else."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
DOCUMENT = (ROOT / "docs" / "dependencies.md").read_text()


def names(requirements: list[str]) -> set[str]:
    """Packages, without versions and extras."""
    return {re.split(r"[\[><=~!; ]", text)[0].lower() for text in requirements}


def rows(heading: str) -> list[list[str]]:
    """The cells of the table below a heading."""
    table = DOCUMENT.split(f"## {heading}\n")[1].split("\n## ")[0]
    lines = [line for line in table.splitlines() if line.startswith("| ")][1:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_what_is_always_installed_is_listed_with_a_reason() -> None:
    listed = {cells[0].split(" (")[0]: cells for cells in rows("Always installed")}
    assert set(listed) == names(PROJECT["dependencies"])
    assert all(cells[1] and cells[2] for cells in listed.values())


def test_extras_are_listed() -> None:
    listed = {cells[0].strip("`"): cells[1].lower() for cells in rows("Extras")}
    extras = PROJECT["optional-dependencies"]
    assert set(listed) == set(extras)
    for extra, requirements in extras.items():
        told = set(re.findall(r"[a-z][a-z0-9-]+", re.sub(r"\([^)]*\)", "", listed[extra])))
        pinned = {"styl3r", "torch"} if extra == "dev" else set()
        assert told == names(requirements) - pinned, extra
