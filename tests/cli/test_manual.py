"""The manual page and docs/exit_codes.md say what there is, in a form that readers take."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from styl3r_cli import main
from styl3r_cli.errors import MEANINGS, SIGNALS, ExitCode
from styl3r_cli.manual import escaped

ROOT = Path(__file__).parents[2]
MACROS = {".TH", ".SH", ".SS", ".PP", ".TP", ".nf", ".fi"}
SECTIONS = "NAME SYNOPSIS DESCRIPTION COMMANDS EXIT STATUS ENVIRONMENT"


@pytest.fixture(scope="module")
def page() -> str:
    result = subprocess.run(
        [sys.executable, "-m", "styl3r_cli", "man"], capture_output=True, text=True, check=True
    )
    assert result.stderr == ""
    return result.stdout


def commands() -> Iterator[tuple[str, click.Command]]:
    """Full names and commands, those in groups too."""
    context = click.Context(main.group, info_name="styl3r")
    for name in main.COMMANDS:
        command = main.group.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            for inner, nested in command.commands.items():
                yield f"{name} {inner}", nested
        else:
            yield name, command


def test_every_command_and_option_is_in_it(page: str) -> None:
    parts = dict(re.findall(r"^\.SS styl3r ([a-z ]+)\n(.*?)(?=^\.S[SH] )", page, re.S | re.M))
    assert list(parts) == [name for name, _ in commands()]
    for name, command in commands():
        for parameter in command.params:
            if isinstance(parameter, click.Option) and not parameter.hidden:
                assert all(escaped(word) in parts[name] for word in parameter.opts), parameter.name
        examples = re.findall(r"^\.nf\n(.*?)^\.fi", parts[name], re.S | re.M)
        assert any(f"styl3r {name} " in example for example in examples)


def test_its_form_is_what_formatters_expect(page: str) -> None:
    lines = page.splitlines()
    assert lines[0].startswith(".TH STYL3R 1 ")
    assert " ".join(line[4:] for line in lines if line.startswith(".SH ")) == SECTIONS
    assert {line.split()[0] for line in lines if line.startswith((".", "'"))} == MACROS
    assert page.isascii()
    assert [line for line in lines if line in (".nf", ".fi")] == [".nf", ".fi"] * (
        page.count("\n.nf\n")
    )
    assert set(re.findall(r"\\(?:\([a-z]{2}|\[u[0-9A-F]{4,5}\]|.)", page)) <= {
        *(r"\fB", r"\fI", r"\fR"),
        *(r"\f", r"\-", r"\&", r"\(rs", r"\(aq", r"\(ga", r"\(ha", r"\(ti"),
        *{escaped(sign) for sign in "°×é→–"},
    }
    assert all(lines[at + 1] and lines[at + 2] for at, line in enumerate(lines) if line == ".TP")


def test_groff_reads_it_without_a_warning(page: str) -> None:
    if not shutil.which("groff"):
        pytest.skip("groff is not installed")
    shown = subprocess.run(
        ["groff", "-man", "-Tutf8", "-ww", "-P-c", "-rLL=120n"],
        input=page.encode(),
        capture_output=True,
        check=True,
    )
    assert shown.stderr == b""
    text = re.sub(r".\x08", "", shown.stdout.decode())
    assert "find photos -name '*.jpg' -print0 | sort -z | styl3r stylize -0 -" in text
    assert 'eval "$(styl3r completion bash)"' in text


@pytest.mark.parametrize(
    ("text", "roff"),
    [
        ("a\\b", r"a\(rsb"),
        ("--x 'y' `z` ~ ^", r"\-\-x \(aqy\(aq \(gaz\(ga \(ti \(ha"),
        ("40°", r"40\[u00B0]"),
    ],
)
def test_signs_that_roff_would_change(text: str, roff: str) -> None:
    assert escaped(text) == roff


def test_it_names_every_variable_that_is_read(page: str) -> None:
    part = page.split(".SH ENVIRONMENT")[1]
    sources = [path.read_text() for path in (ROOT / "styl3r_cli").rglob("*.py")]
    read = {n for s in sources for n in re.findall(r'environ(?:\.get\(|\[)"(\w+)"', s)}
    assert {"TERM", "NO_COLOR", "DISPLAY"} <= read
    assert [n for n in {*read, main.DEBUG, "STYL3R_LOG"} if n not in part] == []


def test_exit_codes_are_the_same_everywhere(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    meant = {str(int(code)): text for code, text in (MEANINGS | SIGNALS).items()}
    assert set(MEANINGS) == set(ExitCode)
    document = (ROOT / "docs" / "exit_codes.md").read_text()
    assert dict(re.findall(r"^\| (\d+) \| ([^|]*) \|", document, re.M)) == meant
    part = page.split(".SH EXIT STATUS")[1].split(".SH")[0]
    found = dict(re.findall(r"^\.TP\n\\fB(\d+)\\fR\n(.*)", part, re.M))
    assert found == {code: escaped(text) for code, text in meant.items()}
    assert main.run(["--help"]) == 0
    shown = capsys.readouterr().out
    assert all(
        re.search(rf"\b{int(code)} +{re.escape(MEANINGS[code])}", shown) for code in ExitCode
    )


def test_it_is_no_command_of_the_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["man", "--help"]) == 0
    assert "styl3r man | man -l -" in capsys.readouterr().out
    assert main.run(["mann"]) == ExitCode.USAGE
    assert " man" not in capsys.readouterr().err.replace("'mann'", "")


def test_the_installed_page_is_this_one(page: str) -> None:
    """After a change of options or presets: styl3r man > docs/styl3r.1."""
    assert (ROOT / "docs" / "styl3r.1").read_text(encoding="utf-8") == page
