"""Cache folder for compiled programs and derived values; disabled until `use_cache_folder` sets one.

Compiled programs are machine code that is executed, so a folder that another user owns or can write to is not used. A
missing folder is created with access for its owner only. Systems without POSIX owners (Windows) rely on the profile.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import warnings
from functools import cache
from pathlib import Path

from pftwin.base.errors import OutputError, PftwinWarning
from pftwin.base.output import written_whole

MOST = 500_000_000  # [bytes] per subfolder; beyond, the least recently used files are deleted until half is left
_chosen: list[Path] = []  # the folder in use, if any


def use_cache_folder(folder: str | os.PathLike[str] | None) -> bool:
    """Sets the cache folder and creates it if missing; None disables caching.

    Returns:
        Whether the folder is used. If it is not a folder, cannot be created, or another user owns it or can write to
        it, this warns and caching is disabled.
    """
    _chosen[:] = [] if folder is None else [Path(folder).absolute()]
    if problem := next(filter(None, map(_problem, _chosen)), None):
        _chosen.clear()
        text = f"{Path(folder or '').absolute()}: {problem}, or another folder (the variable PFTWIN_CACHE)"
        warnings.warn(text, PftwinWarning, stacklevel=2)
    return bool(_chosen)


def _problem(path: Path) -> str | None:
    """Why a folder cannot be used, and what to do; None if it can, after creating it."""
    try:
        if path.exists() and not path.is_dir():
            raise NotADirectoryError
        if unsafe := _unsafe(path):
            return f"{unsafe}; nothing is cached, as its programs would be run; try: chmod -R go-w on one of your own"
        for place in (path, compiled_folder(path)):  # JAX would create it with the default mode
            place.mkdir(mode=0o700, parents=True, exist_ok=True)
    except (OSError, ValueError) as error:  # a file, below a file, read-only, a name too long or with a zero byte
        why = "is no folder" if isinstance(error, FileExistsError | NotADirectoryError) else f"cannot be used: {error}"
        return f"{why}; nothing is cached; try: a folder that you may write to"
    return None


def _unsafe(path: Path) -> str | None:
    """Why a folder, or one of its existing subfolders, is unsafe; None if it is safe."""
    for place in (path, path / "programs", path / "values", compiled_folder(path)):
        if hasattr(os, "getuid") and place.exists():
            found = place.stat()
            if found.st_uid != os.getuid():
                return f"{place.name} belongs to another user"
            if found.st_mode & 0o022:
                return f"others can write to {place.name}"
    return None


def chosen() -> Path | None:
    """The cache folder; None if caching is disabled."""
    return _chosen[0] if _chosen else None


@cache
def compiled_folder(base: Path) -> Path:
    """Folder of JAX's cache for this processor; its keys do not depend on the processor, and homes may be shared."""
    try:
        lines = Path("/proc/cpuinfo").read_text().split("\n\n")[0].splitlines()
        able = [x for x in lines if x.split(":")[0].strip() in ("flags", "Features", "model name")]
    except OSError:
        able = [platform.node(), platform.processor()]
    processor = " ".join((platform.system(), platform.machine(), *able))
    return base / f"compiled-{hashlib.sha256(processor.encode()).hexdigest()[:12]}"


def read(kind: str, key: str) -> bytes | None:
    """The bytes stored under `key`; None if there are none, or if the file was written under another name."""
    base = chosen()
    with contextlib.suppress(OSError):
        if base is not None:
            body, label = (base / kind / key).read_bytes(), _label(kind, key)
            with contextlib.suppress(OSError):
                os.utime(base / kind / key)  # marks it as recently used
            return body.removeprefix(label) if body.startswith(label) else None
    return None


def write(kind: str, key: str, body: bytes) -> None:
    """Stores bytes under `key` atomically; warns if the folder is not writable."""
    base = chosen()
    if base is None:
        return
    try:
        base.parent.mkdir(parents=True, exist_ok=True)
        base.mkdir(mode=0o700, exist_ok=True)
        (base / kind).mkdir(mode=0o700, exist_ok=True)
        with written_whole(base / kind / key) as path:
            path.write_bytes(_label(kind, key) + body)
        _make_room(base / kind)
    except (OSError, OutputError) as error:
        text = f"{base / kind}: nothing can be stored here for the next process: {error}"
        warnings.warn(text, PftwinWarning, stacklevel=2)


def _label(kind: str, key: str) -> bytes:
    """Header of a file: its own name, so that it is not mistaken for another one."""
    return f"{kind}/{key}\n".encode()


def _make_room(place: Path) -> None:
    with contextlib.suppress(FileNotFoundError):  # another process is writing it
        files = sorted((path.stat().st_mtime, path.stat().st_size, path) for path in place.iterdir())
        total = sum(size for _, size, _ in files)
        limit = MOST if total <= MOST else MOST // 2
        for _, size, path in files:
            if total <= limit:
                return
            path.unlink()
            total -= size
