"""Threads of the live page: a worker that serves all pages, and a player of a motion."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable, Hashable

Job = Callable[[], None]
RATE = 30.0  # most frames a second


class Worker:
    """One thread that runs jobs of several owners in turn; an owner's new job replaces its waiting one.

    If a job raises, the traceback is printed on stderr, and the thread continues.
    """

    def __init__(self, name: str) -> None:
        self._waiting: dict[Hashable, Job] = {}
        self._change = threading.Condition()
        self._ends = False
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def submit(self, owner: Hashable, job: Job) -> None:
        """Queues a job; it replaces the owner's waiting job, if there is one."""
        with self._change:
            self._waiting[owner] = job
            self._change.notify()

    def forget(self, owner: Hashable) -> None:
        """Cancels the owner's waiting job."""
        with self._change:
            self._waiting.pop(owner, None)

    def stop(self, timeout: float = 5.0) -> None:
        """Ends the thread after its current job, and waits for that at most `timeout` seconds."""
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
    """Calls `show` in a separate thread with times [s] of the motion, in real time and in a loop."""

    def __init__(self, show: Callable[[float], None], begin: float, end: float) -> None:
        self._show, self._begin, self._end = show, begin, end
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def playing(self) -> bool:
        """Whether the motion is playing."""
        return self._thread is not None

    def play(self, now: float) -> None:
        """Plays from a time [s], or from the start if that is the end."""
        self.pause()
        self._stop = threading.Event()
        first = self._begin if now >= self._end - 1e-6 else now
        self._thread = threading.Thread(target=self._run, args=(first, self._stop), name="player", daemon=True)
        self._thread.start()

    def pause(self) -> None:
        """Stops at the current frame."""
        self._stop.set()
        thread, self._thread = self._thread, None
        if thread is not None and thread is not threading.current_thread():
            thread.join(2.0)

    def _run(self, first: float, stop: threading.Event) -> None:
        began, length = time.perf_counter(), max(self._end - self._begin, 1e-3)
        while not stop.wait(1 / RATE):
            elapsed = first - self._begin + time.perf_counter() - began
            self._show(self._begin + elapsed % length)
