"""A page of another site cannot turn the sliders of the page that is served here."""

from __future__ import annotations

import sys
import types

import pytest

from fitting.cli.live.access import checked_origins, guarded_servers, own_pages
from pftwin.base.errors import InputError, PftwinError

HERE = "localhost:8080"


@pytest.mark.parametrize(
    ("origins", "asked", "expected"),
    [
        ([], HERE, True),  # no browser
        (["http://localhost:8080"], HERE, True),
        (["http://127.0.0.1:8080"], "127.0.0.1:8080", True),
        (["http://[::1]:8080"], "[::1]:8080", True),
        (["http://localhost:9000"], "localhost:9000", True),  # by a tunnel
        (["https://evil.example"], HERE, False),
        (["http://localhost:3000"], HERE, False),  # another server on this machine
        (["http://evil.example:8080"], "evil.example:8080", False),  # whose name leads here
        (["http://localhost.evil.example:8080"], "localhost.evil.example:8080", False),
        (["http://localhost:8080@evil.example"], HERE, False),
        (["http://192.0.2.7:8080"], "192.0.2.7:8080", False),
        (["null"], HERE, False),
        ([""], "", False),
        (["http://[1"], "[1", False),
        (["http://localhost:8080", "https://evil.example"], HERE, False),
    ],
)
def test_who_may_connect_on_this_machine(origins, asked, expected):
    assert own_pages("127.0.0.1")(origins, asked) is expected


def test_where_others_reach_it_names_of_others_are_still_refused(monkeypatch):
    monkeypatch.setattr("socket.gethostname", lambda: "Knee")
    monkeypatch.setattr("socket.getfqdn", lambda: "knee.lab.example")
    allowed = own_pages("0.0.0.0")
    for name in ("localhost", "192.0.2.7", "[2001:db8::1]", "knee", "knee.lab.example"):
        assert allowed([f"http://{name}:8080"], f"{name}:8080"), name
        assert not allowed(["http://evil.example:8080"], f"{name}:8080"), name
    assert not allowed(["http://evil.example:8080"], "evil.example:8080")


def test_a_proxys_origin_is_let_in_by_name():
    allowed = own_pages("127.0.0.1", checked_origins(["https://Hub.example.org/"]))
    assert allowed(["https://hub.example.org"], HERE)
    assert not allowed(["http://hub.example.org"], HERE)
    for wrong in ("hub.example.org", "ftp://hub.example.org", "https://hub.example.org/user", "*"):
        with pytest.raises(InputError, match=r"--origin: found .* expected: such as https://hub.example.org"):
            checked_origins([wrong])


def test_a_server_that_cannot_be_guarded_is_not_left_unguarded():
    pytest.importorskip("websockets")
    with pytest.raises(PftwinError, match="cannot guard"), guarded_servers(own_pages("127.0.0.1")):
        pass


def test_what_it_replaces_is_put_back(monkeypatch):
    module = types.SimpleNamespace(serve=lambda *a, **k: (a, k))
    server = pytest.importorskip("websockets.asyncio.server")
    monkeypatch.setattr(server, "serve", module.serve)
    with guarded_servers(own_pages("127.0.0.1")):
        assert sys.modules["websockets.asyncio.server"].serve is not module.serve
        server.serve("handler", process_request=None)
    assert server.serve is module.serve
