"""What becomes of a file that is read: a value or a refusal in words, in good time and little memory, or a finding."""

from __future__ import annotations

import gc
import resource
import signal
import sys
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fuzz.readers import Reader

from pftwin.base.errors import PftwinError

MOST_SECONDS = 5
MOST_MEMORY = 10**9  # bytes beyond what the process has


class TooSlowError(BaseException):
    """No reader that catches every Exception takes it for one of its own."""


def verdict(reader: Reader, content: bytes, folder: Path) -> str | None:
    """None where all is well, else what is wrong with the reader."""
    file = folder / f"fuzzed{reader.suffix}"
    file.write_bytes(content)
    try:
        with warnings.catch_warnings(), _in_time():
            warnings.simplefilter("ignore")
            reader.read(file)
    except PftwinError as error:
        return None if str(error).strip() else "a refusal without words"
    except TooSlowError:
        return f"not done in {MOST_SECONDS} s: {_place()}"
    except Exception:
        return f"{type(sys.exception()).__name__}: {sys.exception()!s:.200} at {_place()}"
    return None


@contextmanager
def little_memory() -> Iterator[None]:
    """More than `MOST_MEMORY` beyond what is mapped now cannot be had: MemoryError."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    gc.collect()
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MOST_MEMORY, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


@contextmanager
def _in_time() -> Iterator[None]:
    def late(*_: object) -> None:
        raise TooSlowError

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(MOST_SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def _place() -> str:
    """Where it was raised: the last three functions."""
    frames = traceback.extract_tb(sys.exc_info()[2])[-3:]
    return " < ".join(f"{Path(f.filename).name}:{f.lineno} {f.name}" for f in reversed(frames))
