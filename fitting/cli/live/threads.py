"""The threads of the live page: one that simulates for all pages, and one that plays a motion."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable, Hashable

Job = Callable[[], None]
RATE = 30.0  # most frames a second


class Worker:
    """One thread that does jobs for several owners in turn; an owner's new job replaces its waiting one.

    A job that raises is reported on stderr with its traceback, and the thread goes on.
    """

    def __init__(self, name: str) -> None:
        self._waiting: dict[Hashable, Job] = {}
        self._change = threading.Condition()
        self._ends = False
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def submit(self, owner: Hashable, job: Job) -> None:
        """Queues a job in the place of the owner's job that has not begun, if there is one."""
        with self._change:
            self._waiting[owner] = job
            self._change.notify()

    def forget(self, owner: Hashable) -> None:
        """Drops the owner's job if it has not begun."""
        with self._change:
            self._waiting.pop(owner, None)

    def stop(self, timeout: float = 5.0) -> None:
        """Ends the thread after its current job, for which it waits at most `timeout` seconds."""
        with self._change:
            self._ends = True
            self._waiting.clear()
            self._change.notify()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout)

    def _work(self) -> None:
        while True:
            with self._change:
                self._change.wait_for(lambda: self._ends or bool(self._waiting))
                if self._ends:
                    return
                job = self._waiting.pop(next(iter(self._waiting)))
            try:
                job()
            except Exception:
                traceback.print_exc()


class Player:
    """Calls `show` with times of the motion, at its own pace and over and over, from a thread of its own."""

    def __init__(self, show: Callable[[float], None], begin: float, end: float) -> None:
        self._show, self._begin, self._end = show, begin, end
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def playing(self) -> bool:
        """Whether it runs."""
        return self._thread is not None

    def play(self, now: float) -> None:
        """Begins at a time [s]; from the start if that is the end."""
        self.pause()
        self._stop = threading.Event()
        first = self._begin if now >= self._end - 1e-6 else now
        self._thread = threading.Thread(target=self._run, args=(first, self._stop), name="player", daemon=True)
        self._thread.start()

    def pause(self) -> None:
        """Stops at the last frame."""
        self._stop.set()
        thread, self._thread = self._thread, None
        if thread is not None and thread is not threading.current_thread():
            thread.join(2.0)

    def _run(self, first: float, stop: threading.Event) -> None:
        began, length = time.perf_counter(), max(self._end - self._begin, 1e-3)
        while not stop.wait(1 / RATE):
            gone = first - self._begin + time.perf_counter() - began
            self._show(self._begin + gone % length)
