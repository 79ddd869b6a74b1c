"""Whose web pages may talk to the viewer: its own, and no other site's in the same browser."""

from __future__ import annotations

import ipaddress
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from http import HTTPStatus
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from styl3r_cli.errors import UsageError

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

REFUSED = "This page is another site's.\n"


def allowed(origins: Sequence[str], hosts: Sequence[str], private: bool) -> bool:
    """Whether to answer a request.

    Browsers let every site's pages connect to this machine, and say whose page it is. It must be
    one that came from the address that it connects to. A site can have its own name lead to this
    machine once its page is loaded (DNS rebinding), so that a viewer for this machine alone also
    has to go by a name that only this machine has.

    Args:
        origins: the request's Origin headers; none where no browser asks.
        hosts: its Host headers.
        private: whether the viewer is for this machine alone.
    """
    if not origins:
        return True
    if len(origins) > 1 or len(hosts) != 1:
        return False
    try:
        page = urlsplit(origins[0].lower())
    except ValueError:
        return False
    same = bool(page.netloc) and page.netloc == hosts[0].lower()
    return same and (not private or _is_this_machine(page.hostname or ""))


def _is_this_machine(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:  # a name
        return False


@contextmanager
def own_pages_only(private: bool) -> Iterator[None]:
    """Have a server of viser's that is started in here refuse other sites' pages.

    viser cannot be told to; but it starts its server by websockets' `serve`, one of whose options
    decides about each request. That viser did so is checked: it must not open unguarded.

    Raises:
        UsageError: the installed viser starts its server in another way.
    """
    from websockets.asyncio import server

    plain, guarded = server.serve, []

    def serve(*arguments: Any, process_request: Any = None, **options: Any) -> Any:
        guarded.append(True)
        guard = _guard(process_request, private)
        return plain(*arguments, process_request=guard, **options)

    server.serve = serve  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        server.serve = plain  # type: ignore[misc]
    if not guarded:
        raise UsageError(
            "view: other web sites could not be kept out of this version of viser; install another "
            "one: pip install 'viser==1.1.*'"
        )


def _guard(
    ask: Callable[[ServerConnection, Request], Any] | None, private: bool
) -> Callable[[ServerConnection, Request], Any]:
    """Refuse a request, or ask viser's own function."""

    def answer(connection: ServerConnection, request: Request) -> Response | Any:
        headers = request.headers
        if not allowed(headers.get_all("Origin"), headers.get_all("Host"), private):
            return connection.respond(HTTPStatus.FORBIDDEN, REFUSED)
        return None if ask is None else ask(connection, request)

    return answer
