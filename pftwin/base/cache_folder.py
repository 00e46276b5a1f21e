"""The folder in which programs and derived values persist; off until `use` names one.

Compiled programs are machine code, which is run: a folder that someone else owns or can write to is not used. Where
there is none it is made, for its owner alone. Systems without POSIX owners (Windows) rely on the user's profile.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import stat
import warnings
from functools import cache
from pathlib import Path

from pftwin.base.errors import OutputError, PftwinWarning
from pftwin.base.output import written_whole

MOST = 500_000_000  # [bytes] in one kind's folder; beyond, what was used least recently goes until half is left
_KINDS = ("programs", "values")
_chosen: list[Path] = []  # the folder, or nothing


def use(folder: str | os.PathLike[str] | None) -> bool:
    """Caches in this folder from now on; None: not at all.

    Returns:
        Whether it is used: where another user owns it or can write to it, a warning says so and nothing is cached.
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
    """What is wrong with a folder that exists, and with those in it."""
    if not hasattr(os, "getuid"):
        return None
    for place in (path, *(path / kind for kind in _KINDS), compiled_folder(path)):
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
    """The folder; None where nothing is cached."""
    return _chosen[0] if _chosen else None


@cache
def compiled_folder(base: Path) -> Path:
    """Where JAX's cache goes: its keys do not tell processors apart, and a home folder may serve several."""
    try:
        lines = Path("/proc/cpuinfo").read_text().split("\n\n")[0].splitlines()
        able = [x for x in lines if x.split(":")[0].strip() in ("flags", "Features", "model name")]
    except OSError:
        able = [platform.node(), platform.processor()]
    processor = " ".join((platform.system(), platform.machine(), *able))
    return base / f"compiled-{hashlib.sha256(processor.encode()).hexdigest()[:12]}"


def read(kind: str, key: str) -> bytes | None:
    """The bytes of a file; None where there is none."""
    base = chosen()
    if base is None:
        return None
    path = base / kind / key
    try:
        body = path.read_bytes()
    except OSError:
        return None
    with contextlib.suppress(OSError):
        os.utime(path)  # used now
    return body


def write(kind: str, key: str, body: bytes) -> None:
    """Writes a file, whole or not at all. A folder that cannot be written to is worth a warning, no more."""
    base = chosen()
    if base is None:
        return
    place = base / kind
    try:
        base.parent.mkdir(parents=True, exist_ok=True)
        base.mkdir(mode=0o700, exist_ok=True)
        place.mkdir(mode=0o700, exist_ok=True)
        with written_whole(place / key) as path:
            path.write_bytes(body)
        _make_room(place)
    except (OSError, OutputError) as error:
        warnings.warn(f"{place}: nothing can be kept here for the next process: {error}", PftwinWarning, stacklevel=2)


def _make_room(place: Path) -> None:
    found = []
    for entry in os.scandir(place):
        with contextlib.suppress(OSError):  # another process was quicker
            found.append((entry.stat().st_mtime, entry.stat().st_size, entry.path))
    total = sum(size for _, size, _ in found)
    if total <= MOST:
        return
    for _, size, path in sorted(found):
        Path(path).unlink(missing_ok=True)
        total -= size
        if total <= MOST // 2:
            return
