"""The folder in which things are kept: files that are there whole and unharmed, or not at all.

Compiled programs are machine code, which is run: a folder that someone else owns or can write to is not used. Where
there is none it is made, for its owner alone. Beyond that nobody checks where a file comes from; who can write as this
user can do so anyway. Systems without owners of POSIX's kind (Windows) rely on the rights of the user's profile.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import warnings
from pathlib import Path

from pftwin.errors import OutputError, PftwinWarning
from pftwin.output import written_whole

MOST = 500_000_000  # [bytes] in one kind's folder; beyond, what was used least recently goes until half is left
KINDS = ("answers", "programs", "values")
_MARK = b"pftwin kept 2\n"

_chosen: list[Path] = []  # the folder, or nothing


def use(folder: str | os.PathLike[str] | None) -> bool:
    """Keep things in this folder from now on; None: keep nothing.

    Returns:
        Whether it is used: a folder of others, or that others can write to, is worth a warning, and nothing is kept.
    """
    _chosen[:] = []
    if folder is None:
        return False
    path = Path(folder).absolute()
    problem = _unsafe(path)
    if problem:
        warnings.warn(
            f"{path}: {problem}; nothing is kept, since the programs in it are run; try: chmod -R go-w on a folder of "
            "your own, or another one (the variable PFTWIN_CACHE)",
            PftwinWarning,
            stacklevel=2,
        )
        return False
    _chosen.append(path)
    return True


def _unsafe(path: Path) -> str | None:
    """What is wrong with a folder that is there, and with the kinds' in it."""
    if not hasattr(os, "getuid"):
        return None
    for place in (path, *(path / kind for kind in KINDS)):
        try:
            found = place.stat()
        except OSError:  # it will be made
            continue
        if found.st_uid != os.getuid():
            return f"{place.name} belongs to another user"
        if stat.S_IMODE(found.st_mode) & 0o022:
            return f"others can write to {place.name}"
    return None


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
        base.parent.mkdir(parents=True, exist_ok=True)
        base.mkdir(mode=0o700, exist_ok=True)
        place.mkdir(mode=0o700, exist_ok=True)
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
