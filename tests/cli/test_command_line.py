"""Any words on the command line: an answer or one line, never a bug, and no file out of nothing."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from styl3r_cli import main

COMMANDS = ["stylize", "reconstruct", "render", "convert", "info"]
OPTIONS = [
    "-o",
    "-s",
    "--style",
    "--strength",
    "--size",
    "--fov",
    "--cameras",
    "--cameras-out",
    "--path",
    "--frames",
    "--fps",
    "--format",
    "--background",
    "--video",
    "--preview",
    "--json",
    "-q",
    "--model",
    "--threads",
    "--amplitude",
    "--compare",
    "--help",
    "-0",
    "--",
]
VALUES = [
    "",
    "-",
    "nan",
    "1e400",
    "-1",
    "0",
    "64",
    "64x0",
    "9" * 40,
    "gone.ply",
    "gone.png",
    "~",
    "%",
]
words = st.one_of(
    st.sampled_from(OPTIONS), st.sampled_from(VALUES), st.text(st.characters(codec="utf-8"))
)


@given(st.sampled_from(COMMANDS), st.lists(words, max_size=8))
@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_any_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, rest: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", None)  # nothing is piped in
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main.run([command, *rest])
    assert code in (0, 2, 3, 4, 6), err.getvalue()
    if code:
        assert err.getvalue().count("\n") == 1
        assert err.getvalue().startswith("styl3r: error: ")
    assert list(tmp_path.iterdir()) == []
