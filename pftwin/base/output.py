"""Atomic writing of files, and creation of folders."""

from __future__ import annotations

import errno
import os
import re
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pftwin.base.errors import OutputError


def check_place(path: str | os.PathLike[str]) -> Path:
    """Checks that a file can be written at `path`, and returns it as a `Path`.

    Raises:
        OutputError: the path is a folder, or its parent folder does not exist.
    """
    target = Path(path)
    if target.is_dir():
        raise OutputError(f"{target}: is a folder; try: the name of a file in it")
    if not target.parent.is_dir():
        raise OutputError(f"{target}: cannot be written: there is no folder {target.parent}; try: create it first")
    return target


@contextmanager
def written_whole(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Context manager that writes a file atomically: yields a temporary file, which replaces `path` if no error occurs.

    The temporary file has the same folder and suffix. It is flushed to disk before it replaces `path`, so that after a
    power failure either the old or the new file exists.

    Raises:
        OutputError: the folder does not exist, the path is a folder, or it is not writable.
    """
    target = check_place(path)
    temporary = None
    try:
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.stem}.", suffix=target.suffix)
        os.close(handle)
        temporary = Path(name)
        temporary.chmod(_default_mode())
        yield temporary
        _on_disk(temporary)
        temporary.replace(target)
        if os.name == "posix":
            _on_disk(target.parent)  # the directory entry
    except OSError as err:
        raise OutputError(f"{target}: cannot be written: {err.strerror or err}") from err
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def make_folder(folder: Path, remedy: str = "another folder") -> None:
    """Creates a folder if it does not exist; its parent must exist.

    Raises:
        OutputError: the parent does not exist, the path is a file, or the folder cannot be created.
    """
    try:
        folder.mkdir(exist_ok=True)
    except FileExistsError:
        raise OutputError(f"{folder}: is a file; try: {remedy}") from None
    except FileNotFoundError:
        raise OutputError(f"{folder}: there is no folder {folder.parent}; try: create it first") from None
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error.strerror or error}") from error


def remove_unfinished(folder: Path, names: re.Pattern[str], older: float = 0.0) -> None:
    """Removes temporary files of `written_whole` that a killed process left.

    Args:
        folder: folder to clean; nothing happens if it does not exist.
        names: pattern of the files' names.
        older: minimum time since their last modification [s].

    Raises:
        OutputError: a file cannot be removed.
    """
    for path in folder.iterdir() if folder.is_dir() else ():
        if names.match(path.name) and path.is_file():
            try:
                if time.time() - path.stat().st_mtime >= older:
                    path.unlink()
            except FileNotFoundError:  # another process was quicker
                continue
            except OSError as error:
                raise OutputError(f"{path}: cannot be removed: {error.strerror or error}") from error


def _on_disk(path: Path) -> None:
    """Flushes a file or folder to disk."""
    try:
        handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    except PermissionError:
        if path.is_dir():  # a folder that is writable but not readable
            return
        raise
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP) or not path.is_dir():  # not every file system supports it
            raise
    finally:
        os.close(handle)


def _default_mode() -> int:
    """Mode of a file created by open(); `mkstemp` would make it private."""
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask
