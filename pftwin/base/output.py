"""Files written whole or not at all."""

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
    """The path, if there is a folder for it and it is not a folder itself.

    Raises:
        OutputError: otherwise.
    """
    target = Path(path)
    if target.is_dir():
        raise OutputError(f"{target}: is a folder; try: the name of a file in it")
    if not target.parent.is_dir():
        raise OutputError(f"{target}: cannot be written: there is no folder {target.parent}; try: create it first")
    return target


@contextmanager
def written_whole(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary file beside `path`, of the same suffix, that takes its place when the block ends without an error.

    Its content is on the disk before it takes the place: after a loss of power there is the old file or the new one.

    Raises:
        OutputError: the folder is missing, the path is a folder, or the place cannot be written to.
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
            _on_disk(target.parent)  # the name, too
    except OSError as err:
        raise OutputError(f"{target}: cannot be written: {err.strerror or err}") from err
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def make_folder(folder: Path, remedy: str = "another folder") -> None:
    """Makes a folder in one that is there; it may be there already.

    Raises:
        OutputError: there is no folder to make it in, it is a file, or it cannot be made.
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
    """Removes unfinished files (of `written_whole`) that a killed process left behind.

    Args:
        folder: where; nothing happens if it is not there.
        names: what such files are called.
        older: how long ago they must have been written to [s].

    Raises:
        OutputError: one cannot be removed.
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
    """Waits until changes of a file or folder have reached the disk."""
    try:
        handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    except PermissionError:
        if path.is_dir():  # a folder that may be written to but not listed
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
    """The mode of a file made by open(); temporary files are private otherwise."""
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask
