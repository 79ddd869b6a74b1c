"""`styl3r stylize` when something is wrong: one line, the right code, nothing written."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

Run = Callable[..., tuple[int, bytes, str]]


def one_line(text: str) -> bool:
    return text.startswith("styl3r: error: ") and text.count("\n") == 1


GOOD = "-s style.jpg -o s.ply"
MISTAKES = [
    (f"photos/0.png {GOOD}", 3, "only one photo"),
    (f"photos/0.png no.jpg {GOOD}", 3, "no.jpg: no such file"),
    (f"empty {GOOD}", 3, "empty: no photos in this folder"),
    (f"photos/0.png broken.jpg {GOOD}", 3, "broken.jpg"),
    ("photos -s no.jpg -o s.ply", 3, "no.jpg: no such style"),
    ("photos -s broken.jpg -o s.ply", 3, "broken.jpg"),
    ("photos -s style.jpg=0 -o s.ply", 2, "all style weights"),
    ("photos -s style.jpg=-1 -o s.ply", 2, "from 0 to 1e"),
    ("photos -s style.jpg=nan -o s.ply", 2, "from 0 to 1e"),
    ("photos -s style.jpg --strength nan -o s.ply", 2, "nan"),
    ("photos -s style.jpg -o s.obj", 2, "format '.obj'"),
    ("photos -s style.jpg -o no/s.ply", 6, "the folder no does not exist"),
    ("photos -s style.jpg -o folder.ply", 6, "is a folder"),
    (f"photos {GOOD} --preview photos/0.png", 2, "0.png is also an input"),
    (f"photos {GOOD} --preview sheet.gif", 2, "must end in .png"),
    (f"photos {GOOD} --video v.avi", 2, "must end in one of .mp4"),
    (f"photos {GOOD} --cameras no.json", 3, "no.json"),
    (f"photos {GOOD} --fov 190", 2, "--fov 190"),
    ("photos -s style.jpg -o - --json", 2, "both want standard output"),
]


@pytest.mark.parametrize(("arguments", "expected", "words"), MISTAKES)
def test_mistakes_get_one_line_and_their_code(
    run: Run,
    photos: list[Path],
    style: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: str,
    expected: int,
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "folder.ply").mkdir()
    (tmp_path / "broken.jpg").write_bytes(b"\xff\xd8\xff not a photo")
    before = sorted(tmp_path.rglob("*"))
    code, out, err = run("stylize", *arguments.split())
    assert (code, out) == (expected, b"")
    *notes, error = err.splitlines(keepends=True)
    assert one_line(error)
    assert words in error
    assert all("error" not in note for note in notes)
    assert sorted(tmp_path.rglob("*")) == before  # nothing was written


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
def test_protected_folder(run: Run, photos: list[Path], style: Path, tmp_path: Path) -> None:
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o500)
    code, _, err = run("stylize", *photos, "-s", style, "-o", folder / "s.ply")
    assert code == 6
    assert "permission denied" in err


def test_damaged_model(tiny_model: Path, photos: list[Path], style: Path, tmp_path: Path) -> None:
    model = Path(shutil.copytree(tiny_model, tmp_path / "model"))
    with (model / "structure.onnx").open("ab") as file:
        file.write(b"\0")
    command = [sys.executable, "-m", "styl3r_cli", "stylize", *map(str, photos), "-s", str(style)]
    command += ["-o", str(tmp_path / "s.ply"), "--model", str(model), "--fov", "50"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout) == (4, "")
    assert one_line(result.stderr)
    assert "structure.onnx" in result.stderr


def test_two_programs_in_a_pipe(
    tiny_model: Path, photos: list[Path], style: Path, tmp_path: Path
) -> None:
    """`stylize -o - | render -`, and a reader that leaves early."""
    program = f"'{sys.executable}' -m styl3r_cli"
    stylize = (
        f"{program} stylize '{photos[0].parent}' -s '{style}' -o - --model '{tiny_model}' --fov 50"
    )
    command = f"set -o pipefail; {stylize} | {program} render - --frames 1 -o '{tmp_path}/a.png'"
    result = subprocess.run(["bash", "-c", command], capture_output=True, check=False)
    assert (result.returncode, result.stdout, result.stderr) == (0, b"", b"")
    picture = np.asarray(Image.open(tmp_path / "a.png"))
    assert picture.shape == (512, 512, 3)
    assert picture.std() > 10
    command = f"{stylize} | head -c 100 > /dev/null; exit ${{PIPESTATUS[0]}}"
    result = subprocess.run(["bash", "-c", command], capture_output=True, check=False)
    assert (result.returncode, result.stderr) == (141, b"")
    command = f"{stylize.replace('-o -', '--json -o s.ply')} | true; exit ${{PIPESTATUS[0]}}"
    result = subprocess.run(["bash", "-c", command], capture_output=True, cwd=tmp_path, check=False)
    assert (result.returncode, result.stderr) == (141, b"")
