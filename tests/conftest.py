"""Photos, paintings and a tiny model, made on the fly."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tiny_model import write_model


@pytest.fixture(scope="session", autouse=True)
def ctrl_c() -> None:
    """Let SIGINT mean Ctrl-C, also where a shell started the tests in the background.

    Such a shell has it ignored, and processes that the tests start would inherit that.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def tiny_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a model whose geometry and colours are known in closed form."""
    pytest.importorskip("onnx", reason="onnx makes the test graphs")
    return write_model(tmp_path_factory.mktemp("tiny"))


@pytest.fixture(scope="session")
def make_picture() -> Callable[..., Path]:
    """Writes a smooth random picture to a path (any suffix that Pillow knows)."""

    def make(path: Path, seed: int = 0, size: tuple[int, int] = (96, 80)) -> Path:
        coarse = np.random.default_rng(seed).integers(0, 256, (5, 6, 3), dtype=np.uint8)
        Image.fromarray(coarse).resize(size, Image.Resampling.BICUBIC).save(path)
        return path

    return make


@pytest.fixture
def photos(tmp_path: Path, make_picture: Callable[..., Path]) -> list[Path]:
    """Three photos in a folder of their own."""
    folder = tmp_path / "photos"
    folder.mkdir()
    return [make_picture(folder / f"{index}.png", seed=index) for index in range(3)]


@pytest.fixture
def style(tmp_path: Path, make_picture: Callable[..., Path]) -> Path:
    """A style picture."""
    return make_picture(tmp_path / "style.jpg", seed=99, size=(120, 100))


@pytest.fixture
def run(
    tiny_model: Path, capsysbinary: pytest.CaptureFixture[bytes]
) -> Callable[..., tuple[int, bytes, str]]:
    """Runs a command with the tiny model: exit code, stdout, stderr."""

    def run_command(*arguments: object) -> tuple[int, bytes, str]:
        from styl3r_cli import main

        capsysbinary.readouterr()
        command = [*map(str, arguments), "--model", str(tiny_model), "--threads", "1"]
        code = main.run(command)
        out, err = capsysbinary.readouterr()
        return code, out, err.decode()

    return run_command
