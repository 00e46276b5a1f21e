"""The folder in which things are kept: files that are there whole and unharmed, or not at all.

The folder is the user's own, like that of JAX's compilation cache: what lies in it is loaded and run (programs, pickled
values), so it must not be writable by others.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import warnings
from pathlib import Path

from pftwin.errors import OutputError, PftwinWarning
from pftwin.output import written_whole

MOST = 500_000_000  # [bytes] in one kind's folder; beyond, what was used least recently goes until half is left
_MARK = b"pftwin kept 1\n"

_chosen: list[Path] = []  # the folder, or nothing


def use(folder: str | os.PathLike[str] | None) -> None:
    """Keep things in this folder from now on; None: keep nothing."""
    _chosen[:] = [] if folder is None else [Path(folder).absolute()]


def chosen() -> Path | None:
    """The folder, None where nothing is kept."""
    return _chosen[0] if _chosen else None


def read(kind: str, key: str) -> bytes | None:
    """What was kept under a key; None where there is nothing, or something damaged."""
    base = chosen()
    if base is None:
        return None
    path = base / kind / key
    try:
        content = path.read_bytes()
    except OSError:
        return None
    start = len(_MARK) + 32
    body = content[start:]
    if content[:start] != _MARK + hashlib.sha256(body).digest():
        return None
    with contextlib.suppress(OSError):
        os.utime(path)  # used now
    return body


def write(kind: str, key: str, body: bytes) -> None:
    """Keeps it. A folder that cannot be written to is worth a warning, no more."""
    base = chosen()
    if base is None:
        return
    place = base / kind
    try:
        place.mkdir(parents=True, exist_ok=True)
        with written_whole(place / key) as path:
            path.write_bytes(_MARK + hashlib.sha256(body).digest() + body)
        _make_room(place)
    except (OSError, OutputError) as error:
        warnings.warn(f"{place}: nothing can be kept here for the next process: {error}", PftwinWarning, stacklevel=2)


def _make_room(place: Path) -> None:
    found = []
    for entry in os.scandir(place):
        try:
            found.append((entry.stat().st_mtime, entry.stat().st_size, entry.path))
        except OSError:  # another process was quicker
            continue
    total = sum(size for _, size, _ in found)
    if total <= MOST:
        return
    for _, size, path in sorted(found):
        Path(path).unlink(missing_ok=True)
        total -= size
        if total <= MOST // 2:
            return
