"""A client of the live page without a browser: speaks viser's protocol, so that it can say what no browser would."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

import msgspec
import zstandard
from websockets.sync.client import connect

CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, 0.0, 400.0),
    "fov": 0.5,
    "near": 1.0,
    "far": 5000.0,
    "image_height": 600,
    "image_width": 800,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (1.0, 0.0, 0.0),
}


class PageClient:
    """Remembers what the server says of the page's elements: by label, by content."""

    def __init__(self, address: str, origin: Any = None) -> None:
        import viser

        protocol: Any = f"viser-v{viser.__version__}"
        self._socket = connect(address.replace("http", "ws"), subprotocols=[protocol], max_size=None, origin=origin)
        self._unpack = zstandard.ZstdDecompressor()
        self.elements: dict[str, dict[str, Any]] = {}  # by uuid
        self.nodes: dict[str, dict[str, Any]] = {}  # by name
        self.send(CAMERA)

    def __enter__(self) -> PageClient:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._socket.close()

    def send(self, message: dict[str, Any] | bytes) -> None:
        self._socket.send(message if isinstance(message, bytes) else msgspec.msgpack.encode(message))

    def uuid(self, label: str) -> str:
        """Of the first element with this label."""
        return next(u for u, e in self.elements.items() if e.get("label") == label)

    def move(self, label: str, value: Any) -> None:
        """As a slider does, or with a value that none has."""
        self.send({"type": "GuiUpdateMessage", "uuid": self.uuid(label), "updates": {"value": value}})

    def value(self, label: str) -> Any:
        return self.elements[self.uuid(label)]["value"]

    def text(self) -> str:
        """All HTML of the page."""
        return "\n".join(str(e["content"]) for e in self.elements.values() if "content" in e)

    def wait(self, until: Callable[[PageClient], Any], seconds: float = 120.0) -> None:
        """Listens until something is so.

        Raises:
            TimeoutError: it never was; with what the page says instead.
        """
        end = time.monotonic() + seconds
        while not until(self):
            try:
                self._hear(self._socket.recv(timeout=max(end - time.monotonic(), 0.01)))
            except TimeoutError:
                raise TimeoutError(f"the page says: {self.text()}") from None

    def listen(self, seconds: float) -> None:
        """Takes note of what is said in a time."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                self._hear(self._socket.recv(timeout=left))
            except TimeoutError:
                return

    def wait_for(self, *words: str) -> None:
        """Until the page says all of this."""
        self.wait(lambda c: all(w in c.text() for w in words))

    def _hear(self, raw: Any) -> None:
        size = int.from_bytes(raw[8:16], "little")
        for message in msgspec.msgpack.decode(self._unpack.decompress(raw[16 : 16 + size]))["messages"]:
            kind = message["type"]
            if kind == "GuiUpdateMessage":
                self.elements.setdefault(message["uuid"], {}).update(message["updates"])
            elif kind.startswith("Gui") and "props" in message:
                value = {"value": message["value"]} if "value" in message else {}
                self.elements[message["uuid"]] = {**message["props"], **value}
            elif "name" in message:
                self.nodes.setdefault(message["name"], {}).update(message)
