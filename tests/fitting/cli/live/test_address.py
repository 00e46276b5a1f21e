"""Addresses that a page can be served at."""

from __future__ import annotations

import socket

import pytest

from fitting.cli.live.access import check_address, loopback
from pftwin.base.errors import InputError


def test_who_can_reach_an_address():
    assert all(loopback(a) for a in ("localhost", "127.0.0.1", "127.8.8.8", "::1"))
    assert not any(loopback(a) for a in ("0.0.0.0", "::", "192.168.1.5", "example.org"))


@pytest.mark.parametrize("host", ["no.such.host.invalid", "192.0.2.1", "", "a" * 300])
def test_an_address_that_is_not_of_this_machine_is_refused(host):
    with pytest.raises(InputError, match=r"is no address of this machine; expected: 127\.0\.0\.1"):
        check_address(host, 0)


def test_a_port_that_is_taken_is_left_to_the_server():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        check_address("127.0.0.1", taken.getsockname()[1])
