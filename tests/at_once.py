"""A limit of time for input that is made to take for ever, far above what it takes on a busy machine."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

LIMIT = 20.0  # [s] of the process: such input takes milliseconds, or minutes where time grows as the square of it


@contextmanager
def at_once() -> Iterator[None]:
    """What happens within took less than `LIMIT`; no speed is tested, it is how the time grows that is."""
    began = time.process_time()
    yield
    spent = time.process_time() - began
    assert spent < LIMIT, f"{spent:.0f} s"
