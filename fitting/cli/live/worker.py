"""One thread that does jobs for several owners: a new job of an owner takes the place of the one still waiting."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable, Hashable

Job = Callable[[], None]


class Worker:
    """Does one job at a time, owners in the order in which they came: none waits for more than one job of each other.

    A job that raises is reported on stderr with its traceback, and the next one is done.
    """

    def __init__(self, name: str) -> None:
        self._waiting: dict[Hashable, Job] = {}
        self._change = threading.Condition()
        self._ends = False
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def submit(self, owner: Hashable, job: Job) -> None:
        """Asks for a job. What the owner asked for before and was not begun is dropped; its place is kept."""
        with self._change:
            self._waiting[owner] = job
            self._change.notify()

    def forget(self, owner: Hashable) -> None:
        """Drops the owner's job, if it was not begun."""
        with self._change:
            self._waiting.pop(owner, None)

    def stop(self, timeout: float = 5.0) -> None:
        """Ends the thread after the job that it is doing, for which this waits so long at most [s]."""
        with self._change:
            self._ends = True
            self._waiting.clear()
            self._change.notify()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout)

    def _next(self) -> Job | None:
        with self._change:
            self._change.wait_for(lambda: self._ends or bool(self._waiting))
            if self._ends:
                return None
            return self._waiting.pop(next(iter(self._waiting)))

    def _work(self) -> None:
        while (job := self._next()) is not None:
            try:
                job()
            except Exception:
                traceback.print_exc()
