"""The web server of the live page, with access control and handling of malformed messages."""

from __future__ import annotations

import contextlib
import io
import logging
import sys
import threading
import traceback
import warnings
from collections.abc import Collection, Iterator
from typing import Any

from fitting.cli.live.access import check_address, guarded_servers, own_pages
from fitting.cli.live.engine import Engine
from fitting.cli.live.session import Session
from fitting.cli.live.threads import Worker
from pftwin.base.errors import MissingExtraError
from pftwin.results.viewer.framing import views


def viser() -> Any:
    """Imports the package viser; MissingExtraError if it is not installed."""
    try:
        import viser as package
    except ImportError as error:
        raise MissingExtraError("viser", extra="app", feature="the live page") from error
    return package


class LiveServer:
    """Serves a separate page to every client until `stop` is called."""

    def __init__(
        self, engine: Engine, host: str = "127.0.0.1", port: int = 8080, origins: Collection[str] = ()
    ) -> None:
        """Starts to serve an engine whose first contact is prepared, to its own pages and to pages of `origins`.

        If the port is in use, takes the next free one. Raises InputError if this machine has no such address.
        """
        package = viser()
        check_address(host, port)
        self._engine = engine
        self._workers = [Worker(name) for name in ("simulating", "preparing", "drawing bands")]
        self._sessions: dict[int, Session] = {}
        self._lock = threading.Lock()
        _quiet_about_broken_messages()

        class Private(package.ViserServer):
            """Never opens the public tunnel that viser's pages can request."""

            def request_share_url(self, verbose: bool = True) -> str | None:
                del verbose
                return None

        with _viser_silenced(), guarded_servers(own_pages(host, origins)):
            self._server = Private(host=host, port=port, verbose=False)
        self.host, self.port = host, int(self._server.get_port())
        loop = self._server.get_event_loop()
        loop.call_soon_threadsafe(loop.set_exception_handler, self._on_malformed_message)
        self._set_appearance(engine)
        self._server.on_client_connect(self._on_connect)
        self._server.on_client_disconnect(self._on_disconnect)

    @property
    def address(self) -> str:
        """URL to open in a browser."""
        host = "localhost" if self.host in ("0.0.0.0", "::") else self.host
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}"

    @property
    def sessions(self) -> tuple[Session, ...]:
        """Sessions of the connected clients."""
        with self._lock:
            return tuple(self._sessions.values())

    def stop(self) -> None:
        """Closes the pages, the server and the threads."""
        for session in self.sessions:
            session.close()
        with _viser_silenced():
            self._server.stop()
        for worker in self._workers:
            worker.stop()

    def _set_appearance(self, engine: Engine) -> None:
        server = self._server
        server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        server.scene.set_up_direction("+x")
        server.scene.configure_default_lights(True, cast_shadow=False)
        camera = views(engine.model(engine.contacts[0]).before.recorded)["anterior"]
        first = server.initial_camera
        first.position, first.look_at, first.up = camera[:3], camera[3:6], camera[6:]
        first.fov, first.near, first.far = 0.52, 1.0, 5000.0

    def _on_connect(self, client: Any) -> None:
        session = Session(client, self._engine, *self._workers)
        with self._lock:
            self._sessions[client.client_id] = session
        if client.client_id not in self._server.get_clients():  # left during set-up
            self._on_disconnect(client)

    def _on_disconnect(self, client: Any) -> None:
        with self._lock:
            session = self._sessions.pop(client.client_id, None)
        if session is not None:
            session.close()

    def _on_malformed_message(self, loop: Any, context: dict[str, Any]) -> None:
        """Reports a malformed message in one line on stderr and on its page; the server continues."""
        error = context.get("exception")
        if error is None:
            loop.default_exception_handler(context)
            return
        sys.stderr.write(f"ignored a malformed message from a page: {_line(error)}\n")
        session = self._sessions.get(_client_of(error))
        if session is not None:
            session.refuse(f"the page sent a malformed message: {_line(error)}")


def _line(error: BaseException) -> str:
    return f"{type(error).__name__}: {str(error)[:120]}" if str(error) else type(error).__name__


def _client_of(error: BaseException) -> Any:
    """Id of the client whose message caused an error, from the frames of viser's handlers."""
    numbers = [f.f_locals.get("client_id") for f, _ in traceback.walk_tb(error.__traceback__)]
    return next((n for n in reversed(numbers) if n is not None), None)


class _OneLine(logging.Formatter):
    """Formats errors in one line without a traceback, because an unreadable message is not a bug in this program."""

    def format(self, record: logging.LogRecord) -> str:
        error = record.exc_info[1] if record.exc_info else None
        why = "" if error is None else f": {_line(error)}"
        return f"a connection was closed, {record.getMessage()}{why}"


def _quiet_about_broken_messages() -> None:
    """Sets up one-line reports of broken connections and unreadable messages, and none of closed connections."""
    warnings.filterwarnings("ignore", message="Queued a .* on a closed connection", category=UserWarning)
    logger = logging.getLogger("websockets.server")
    if not logger.handlers:
        handler = logging.StreamHandler()
        handler.setFormatter(_OneLine())
        logger.addHandler(handler)
        logger.propagate = False


@contextlib.contextmanager
def _viser_silenced() -> Iterator[None]:
    """Suppresses the box that viser prints, because the command prints the address itself."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield
