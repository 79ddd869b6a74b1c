"""The viewer answers its own pages and what is no browser, and no other site's pages."""

from __future__ import annotations

import asyncio
from http import HTTPStatus

import numpy as np
import pytest

from styl3r_cli.errors import UsageError
from styl3r_cli.gaussians import Gaussians
from styl3r_cli.viewer.address import Address
from styl3r_cli.viewer.origins import allowed, own_pages_only

OURS = "127.0.0.1:8080"
PATIENCE = 60  # seconds, on a busy machine


@pytest.mark.parametrize(
    ("origins", "host", "private", "answer"),
    [
        ([], OURS, True, True),  # no browser
        (["http://127.0.0.1:8080"], OURS, True, True),
        (["http://LocalHost:9000"], "localhost:9000", True, True),  # through a tunnel, say
        (["http://[::1]:8080"], "[::1]:8080", True, True),
        (["http://evil.example"], OURS, True, False),
        (["http://evil.example:8080"], "evil.example:8080", True, False),  # its name leads here
        (["http://127.0.0.1.evil.example"], "127.0.0.1.evil.example", True, False),
        (["http://localhost@evil.example"], OURS, True, False),
        (["http://127.0.0.1:3000"], OURS, True, False),  # another server on this machine
        (["null"], OURS, True, False),  # a page in a sandbox
        (["http://["], OURS, True, False),
        (["http://127.0.0.1:8080", "http://evil.example"], OURS, True, False),
        (["http://192.0.2.7:8080"], "192.0.2.7:8080", True, False),
        (["http://192.0.2.7:8080"], "192.0.2.7:8080", False, True),  # with --host 0.0.0.0
        (["http://desk.local:8080"], "desk.local:8080", False, True),
        (["http://evil.example"], "192.0.2.7:8080", False, False),
    ],
)
def test_who_is_answered(origins: list[str], host: str, private: bool, answer: bool) -> None:
    assert allowed(origins, [host], private) is answer


def status(url: str, origin: str | None) -> int:
    """What the server answers to a page of that origin that opens a WebSocket."""
    from websockets.asyncio.client import connect
    from websockets.exceptions import InvalidStatus
    from websockets.typing import Origin

    async def ask() -> int:
        try:
            async with connect(
                url.replace("http", "ws"), origin=None if origin is None else Origin(origin)
            ) as socket:
                assert socket.response is not None
                return socket.response.status_code
        except InvalidStatus as error:
            return error.response.status_code

    return asyncio.run(asyncio.wait_for(ask(), PATIENCE))


def test_the_installed_viser_is_guarded() -> None:
    pytest.importorskip("viser")
    from styl3r_cli.viewer.server import serving

    one = np.ones((1, 3), np.float32)
    scene = Gaussians(one, one, np.eye(4, dtype=np.float32)[:1], one[:, 0], one)
    with serving({"a.ply": scene}, [], Address("127.0.0.1", 0)) as url:
        assert status(url, "http://evil.example") == HTTPStatus.FORBIDDEN
        assert status(url, url) == HTTPStatus.SWITCHING_PROTOCOLS
        assert status(url, None) == HTTPStatus.SWITCHING_PROTOCOLS


def test_a_viser_that_cannot_be_guarded_is_not_used() -> None:
    server = pytest.importorskip("websockets.asyncio.server")
    plain = server.serve
    with pytest.raises(UsageError, match="install another one"), own_pages_only(private=True):
        pass  # a server that starts in another way
    assert server.serve is plain
