"""The newest wish of an owner is the one that is done, nobody is forgotten, and a job that fails stops nothing."""

from __future__ import annotations

import threading

import pytest

from fitting.cli.live.threads import Worker


@pytest.fixture
def worker():
    made = Worker("test")
    yield made
    made.stop()


class Gate:
    """A job that does not end before it is told to."""

    def __init__(self) -> None:
        self.begun, self.opened = threading.Event(), threading.Event()

    def __call__(self) -> None:
        self.begun.set()
        assert self.opened.wait(30)


def test_the_latest_job_of_an_owner_wins_and_owners_take_turns(worker):
    gate, done, end = Gate(), [], threading.Event()
    worker.submit("gate", gate)
    assert gate.begun.wait(30)
    for i in range(100):
        worker.submit("a", lambda i=i: done.append(("a", i)))
        worker.submit("b", lambda i=i: done.append(("b", i)))
    worker.submit("end", end.set)
    gate.opened.set()
    assert end.wait(30)
    assert done == [("a", 99), ("b", 99)]


def test_what_was_forgotten_is_not_done(worker):
    gate, done, end = Gate(), [], threading.Event()
    worker.submit("gate", gate)
    assert gate.begun.wait(30)
    worker.submit("a", lambda: done.append("a"))
    worker.forget("a")
    worker.submit("end", end.set)
    gate.opened.set()
    assert end.wait(30)
    assert done == []


def test_a_job_that_fails_is_reported_and_the_next_one_is_done(worker, capfd):
    end = threading.Event()

    def fails() -> None:
        raise RuntimeError("on purpose")

    worker.submit("a", fails)
    worker.submit("b", end.set)
    assert end.wait(30)
    assert "RuntimeError: on purpose" in capfd.readouterr().err


def test_stopping_ends_the_thread_and_drops_what_waits():
    worker, gate, done = Worker("to be stopped"), Gate(), []
    worker.submit("gate", gate)
    assert gate.begun.wait(30)
    worker.submit("a", lambda: done.append("a"))
    threading.Timer(0.05, gate.opened.set).start()
    worker.stop(30)
    assert done == []
    assert "to be stopped" not in [t.name for t in threading.enumerate()]
