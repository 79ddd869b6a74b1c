"""`styl3r view` serves the page, starts at the first camera, and ends quietly."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from styl3r_cli import main
from styl3r_cli.cameras.camera import Camera
from styl3r_cli.cameras.stored import cameras_to_metadata
from styl3r_cli.commands import view
from styl3r_cli.errors import ExitCode
from styl3r_cli.formats import write_scene
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.viewer.address import Address, find_address

PATIENCE = 120  # seconds, on a busy machine; it takes two


@pytest.fixture
def gaussians() -> Gaussians:
    rng = np.random.default_rng(1)
    return Gaussians(
        means=rng.uniform([-1, -1, 3], [1, 1, 5], (50, 3)),
        scales=np.full((50, 3), 0.05),
        rotations=np.tile([1.0, 0, 0, 0], (50, 1)),
        opacities=np.full(50, 0.9),
        colours=rng.uniform(0, 1, (50, 3)),
    )


@pytest.fixture
def cameras() -> list[Camera]:
    moved = np.eye(4)
    moved[:3, 3] = [-0.5, 0, 0]
    return [Camera(e, 100.0, 100.0, 50.0, 40.0, 100, 80) for e in (moved, np.eye(4))]


@pytest.fixture
def scene(gaussians: Gaussians, cameras: list[Camera], tmp_path: Path) -> Path:
    path = tmp_path / "scene.ply"
    write_scene(path, gaussians, cameras_to_metadata(cameras))
    return path


def test_the_page_is_there_until_ctrl_c(scene: Path) -> None:
    pytest.importorskip("viser")
    command = [sys.executable, "-m", "styl3r_cli", "view", str(scene), "--no-open", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        url = process.stdout.readline().decode().strip()
        try:
            with urllib.request.urlopen(url, timeout=PATIENCE) as answer:
                page = answer.read()
        finally:
            process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE)
    assert url.startswith("http://127.0.0.1:")
    assert page.lstrip().lower().startswith(b"<!doctype html")
    assert out == b""
    assert err.decode() == "styl3r: Ctrl-C ends the viewer\n"
    assert process.returncode == ExitCode.INTERRUPTED


def received(url: str, version: str, wanted: int) -> list[dict[str, Any]]:
    """What a browser gets from the page's server, up to the splats of that many scenes."""
    import msgspec
    import zstandard
    from websockets.asyncio.client import connect
    from websockets.typing import Subprotocol

    messages: list[dict[str, Any]] = []

    async def listen() -> None:
        address = url.replace("http", "ws")
        async with connect(address, subprotocols=[Subprotocol(f"viser-v{version}")]) as socket:
            while sum(m["type"] == "GaussianSplatsMessage" for m in messages) < wanted:
                data = await socket.recv()
                assert isinstance(data, bytes)
                size = int.from_bytes(data[8:16], "little")
                packed = zstandard.ZstdDecompressor().decompress(data[16 : 16 + size])
                messages.extend(msgspec.msgpack.decode(packed)["messages"])

    asyncio.run(asyncio.wait_for(listen(), PATIENCE))
    return messages


def test_what_the_page_gets(gaussians: Gaussians, cameras: list[Camera]) -> None:
    viser = pytest.importorskip("viser")
    from styl3r_cli.viewer.server import METRES, serving

    scenes = {"a.ply": gaussians, "b.ply": gaussians.with_colours(1 - gaussians.colours)}
    with serving(scenes, cameras, Address("127.0.0.1", 0)) as url:
        messages = received(url, viser.__version__, wanted=2)
    first = {m["type"]: m for m in messages if m.get("initial")}
    position = np.array(first["SetCameraPositionMessage"]["position"])
    target = np.array(first["SetCameraLookAtMessage"]["look_at"])
    assert np.linalg.norm(target - position) == pytest.approx(METRES)
    np.testing.assert_allclose(position / np.linalg.norm(position), [1, 0, 0], atol=1e-6)
    assert first["SetCameraFovMessage"]["fov"] == pytest.approx(2 * np.arctan(0.4))
    shown = {m["name"]: m["visible"] for m in messages if "visible" in m and "name" in m}
    nodes = ("/scene_0", "/scene_1", "/cameras/0", "/cameras/1")
    assert [shown[name] for name in nodes] == [True, False, False, False]


@pytest.mark.parametrize("damaged", [True, False])
def test_it_is_said_once_why_there_are_no_cameras(
    gaussians: Gaussians,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    damaged: bool,
) -> None:
    pytest.importorskip("viser")

    def interrupted(*given: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("styl3r_cli.viewer.server.serving", interrupted)
    write_scene(tmp_path / "a.ply", gaussians, {"camera.0": "1 2 3"} if damaged else {})
    assert main.run(["view", str(tmp_path / "a.ply"), "--no-open"]) == ExitCode.INTERRUPTED
    [note] = capsys.readouterr().err.splitlines()
    words = "cameras are damaged and ignored" if damaged else "no cameras came with the scene"
    assert words in note


def test_without_the_extra_it_says_what_to_install(
    scene: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(view, "find_spec", lambda name: None)
    assert main.run(["view", str(scene)]) == ExitCode.USAGE
    [line] = capsys.readouterr().err.splitlines()
    assert "pip install 'styl3r[view]'" in line


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--host", "no.such.host.invalid"], "not known"),
        (["--host", ""], "not known"),
        (["--host", "192.0.2.1"], "name an address of this machine"),
        (["--compare", "{scene}"], "the scene itself"),
        (["--compare", "{scene}.missing.ply"], "missing.ply"),
    ],
)
def test_mistakes_are_one_line(
    scene: Path, arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("viser")
    code = main.run(["view", str(scene), *(word.format(scene=scene) for word in arguments)])
    out, err = capsys.readouterr()
    assert code in (ExitCode.USAGE, ExitCode.INPUT)
    assert out == ""
    [line] = err.splitlines()
    assert said in line


def test_a_taken_port_is_said_and_the_usual_one_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(Exception, match=f"port {port}: .*choose another --port"):
            find_address("127.0.0.1", port)
        monkeypatch.setattr("styl3r_cli.viewer.address.DEFAULT_PORT", port)
        assert find_address("127.0.0.1", None) == Address("127.0.0.1", 0)
    assert find_address("127.0.0.1", 0) == Address("127.0.0.1", 0)


def test_addresses() -> None:
    assert Address("127.0.0.1", 1).private
    assert Address("::1", 1).private
    assert not Address("0.0.0.0", 1).private
    assert Address("0.0.0.0", 1).url(80) == "http://127.0.0.1:80"
    assert Address("::1", 1).url(8080) == "http://[::1]:8080"


def test_without_a_screen_no_browser_is_started(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("webbrowser.open", lambda url: pytest.fail("a browser was started"))
    notes: list[str] = []
    view.open_browser("http://127.0.0.1:1", notes.append)
    assert len(notes) == 1
    opened: list[str] = []
    monkeypatch.setitem(os.environ, "DISPLAY", ":0")
    monkeypatch.setattr("webbrowser.open", lambda url: bool(opened.append(url)) or True)
    view.open_browser("http://127.0.0.1:1", notes.append)
    assert opened == ["http://127.0.0.1:1"]
    assert len(notes) == 1
