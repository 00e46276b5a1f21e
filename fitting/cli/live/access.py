"""Access control of the live page: addresses to serve at, and origins that may connect to the server.

A browser lets a page of any site open a websocket to any address, local ones included, and states the page's site in
`Origin`. A site can also resolve its name to this machine's address (DNS rebinding): then `Host` and `Origin` agree,
but the name is not one of this machine's.
"""

from __future__ import annotations

import errno
import inspect
import ipaddress
import socket
import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

from pftwin.base.errors import InputError, PftwinError

Allowed = Callable[[list[str], str], bool]


def loopback(host: str) -> bool:
    """Whether an address can be reached only from this machine."""
    address = _ip(host)
    return host == "localhost" or (address is not None and address.is_loopback)


def _ip(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """Parses a numeric IP address; None for other names."""
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None


def check_address(host: str, port: int) -> None:
    """Raises InputError for an address of another machine and for a forbidden port; a port in use is allowed."""
    expected = "127.0.0.1, or 0.0.0.0 for all addresses"
    unknown = InputError(f"{host!r} is no address of this machine", where="--host", expected=expected)
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError):
        raise unknown from None
    with socket.socket(family, kind, protocol) as tried:
        tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tried.bind(place)
        except PermissionError:
            raise InputError(f"port {port} is not allowed", where="--port", expected="1024 or more") from None
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise unknown from None


def checked_origins(given: Collection[str]) -> frozenset[str]:
    """Checks and normalises origins such as "https://hub.example.org"; InputError for anything else."""
    for text in given:
        parts = urlsplit(text)
        if parts.scheme not in ("http", "https") or not parts.netloc or parts.path.strip("/") or parts.query:
            raise InputError(f"found {text!r}", where="--origin", expected="such as https://hub.example.org")
    return frozenset(text.rstrip("/").lower() for text in given)


def own_pages(host: str, also: Collection[str] = ()) -> Allowed:
    """Returns a function of a connection's `Origin` headers and `Host` header that tells whether it is allowed.

    Allowed are this server's own page and pages of the origins `also`. Connections without `Origin` are allowed too:
    they are not from browsers, which always send it, and other programs could send any.
    """
    names = {"localhost", host.lower()}
    if not loopback(host):
        names |= {socket.gethostname().lower(), socket.getfqdn().lower()}

    def allowed(origins: list[str], asked: str) -> bool:
        if len(origins) > 1:
            return False
        if not origins or origins[0].lower() in also:
            return True
        try:
            parts = urlsplit(origins[0].lower())
            name = parts.hostname or ""
        except ValueError:  # brackets that hold no address
            return False
        if parts.scheme not in ("http", "https") or parts.netloc != asked.lower():
            return False
        return loopback(name) if loopback(host) else name in names or _ip(name) is not None

    return allowed


@contextmanager
def guarded_servers(allowed: Allowed) -> Iterator[None]:
    """Context in which servers that viser starts accept only allowed connections; viser has no setting for this.

    Raises PftwinError if viser started no server by `websockets.asyncio.server.serve`.
    """
    import websockets.asyncio.server as module

    real, started = module.serve, False

    def serve(*arguments: Any, process_request: Any, **options: Any) -> Any:
        nonlocal started
        started = True

        async def checked(connection: Any, request: Any) -> Any:
            origins, asked = request.headers.get_all("Origin"), request.headers.get_all("Host")
            if "Upgrade" in request.headers and not allowed(origins, asked[0] if asked else ""):
                origin = ", ".join(origins)[:120].encode("ascii", "backslashreplace").decode()
                advice = f"if it is yours: pftwin app --origin {origin}"
                sys.stderr.write(f"a page of another origin was refused: {origin}; {advice}\n")
                return connection.respond(HTTPStatus.FORBIDDEN, "This page is of another origin.\n")
            answer = process_request(connection, request)
            return await answer if inspect.isawaitable(answer) else answer

        return real(*arguments, process_request=checked, **options)

    module.serve = serve  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield
    finally:
        module.serve = real
    if not started:
        raise PftwinError("this version of viser starts its server in a way that pftwin cannot guard; try: viser 1.1.1")
