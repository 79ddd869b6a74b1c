"""Where the viewer's page is: a host and port that are this machine's, and free."""

from __future__ import annotations

import ipaddress
import os
import socket
from dataclasses import dataclass

from styl3r_cli.errors import UsageError

DEFAULT_HOST = "127.0.0.1"
DEFAULT_PORT = 8080  # as viser's; where it is taken, any other will do


@dataclass(frozen=True)
class Address:
    """Where to listen.

    Attributes:
        host: an IP address of this machine; 0.0.0.0 or :: for all it has.
        port: 0 for any free one.
    """

    host: str
    port: int

    @property
    def private(self) -> bool:
        """Whether only this machine can connect."""
        return ipaddress.ip_address(self.host.partition("%")[0]).is_loopback

    def url(self, port: int) -> str:
        """The page's address for a browser on this machine."""
        if self.host in ("0.0.0.0", "::"):
            return f"http://{DEFAULT_HOST}:{port}"
        return f"http://[{self.host}]:{port}" if ":" in self.host else f"http://{self.host}:{port}"


def find_address(host: str, port: int | None) -> Address:
    """Make sure that a server can listen there (viser itself would try other ports, or hang).

    Args:
        host: a name or IP address.
        port: None for the usual one if it is free, and else for any; 0 for any.

    Raises:
        UsageError: the host is not this machine, or the port is taken or not allowed.
    """
    try:
        if port is None:
            return _try(host, DEFAULT_PORT)
        return _try(host, port)
    except OSError as error:
        if port is not None:
            reason = error.strerror or error
            message = f"{reason}; choose another --port, or 0 for any that is free"
            raise UsageError(f"{host}, port {port}: {message}") from error
    try:
        return _try(host, 0)
    except OSError as error:
        reason = error.strerror or error
        raise UsageError(f"--host {host}: {reason}; name an address of this machine") from error


def _try(host: str, port: int) -> Address:
    try:
        if not host:
            raise ValueError("empty")
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (OSError, ValueError) as error:  # ValueError: names that no host can have
        raise UsageError(f"--host '{host}': not known; use 127.0.0.1 or 0.0.0.0") from error
    family, _, _, _, address = found[0]
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        if os.name == "posix":  # as asyncio does; elsewhere this would allow two servers at a port
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(address)
    return Address(str(address[0]), port)
