"""Where the page is served: who can reach an address, and whether this machine has it."""

from __future__ import annotations

import errno
import ipaddress
import socket

from pftwin.base.errors import InputError


def loopback(host: str) -> bool:
    """Whether an address can be reached from this machine alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def check_address(host: str, port: int) -> None:
    """Refuses an address that no server can have here.

    Raises:
        InputError: no such address on this machine, or a port that is not allowed. One that is taken is no mistake: the
            server takes the next one.
    """
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError):
        raise _no_address(host) from None
    with socket.socket(family, kind, protocol) as tried:
        tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tried.bind(place)
        except PermissionError:
            raise InputError(f"port {port} is not allowed", where="--port", expected="1024 or more") from None
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise _no_address(host) from None


def _no_address(host: str) -> InputError:
    return InputError(
        f"{host!r} is no address of this machine", where="--host", expected="127.0.0.1, or 0.0.0.0 for all of them"
    )
