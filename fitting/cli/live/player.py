"""Plays a motion: asks for its frames one after the other, in the recording's own time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

RATE = 30.0  # most frames a second


class Player:
    """Calls with times of the motion, from a thread of its own, from where it was to the end, and then again."""

    def __init__(self, show: Callable[[float], None], begin: float, end: float) -> None:
        self._show, self._begin, self._end = show, begin, end
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def playing(self) -> bool:
        """Whether it runs."""
        return self._thread is not None

    def play(self, now: float) -> None:
        """Begins at a time [s]; at the end, from the start."""
        self.pause()
        self._stop = threading.Event()
        first = self._begin if now >= self._end - 1e-6 else now
        self._thread = threading.Thread(target=self._run, args=(first, self._stop), name="player", daemon=True)
        self._thread.start()

    def pause(self) -> None:
        """Stops it; the last frame that was asked for stays."""
        self._stop.set()
        thread, self._thread = self._thread, None
        if thread is not None and thread is not threading.current_thread():
            thread.join(2.0)

    def _run(self, first: float, stop: threading.Event) -> None:
        began, length = time.perf_counter(), max(self._end - self._begin, 1e-3)
        while not stop.wait(1 / RATE):
            gone = first - self._begin + time.perf_counter() - began
            self._show(self._begin + gone % length)
