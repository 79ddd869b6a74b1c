"""Every row of the numerical contract names tests that exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
PAGE = TESTS.parent / "docs" / "numerics.md"
NAMED = re.compile(r"`([\w/]+\.py)::(test_\w+)`")


def test_every_row_is_held_by_tests_that_exist() -> None:
    if not PAGE.is_file():
        pytest.skip("docs/ is not part of this copy")
    table = PAGE.read_text(encoding="utf-8").split("## ")[1]
    rows = [line for line in table.splitlines() if line.startswith("|")][2:]
    assert len(rows) > 12
    for row in rows:
        named = NAMED.findall(row)
        assert named, row
        for file, test in named:
            source = (TESTS / file).read_text(encoding="utf-8")
            assert f"def {test}(" in source, f"{file}::{test}"
