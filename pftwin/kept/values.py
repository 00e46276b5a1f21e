"""Values derived from files, kept by the files' content, the arguments and the code that derives them."""

from __future__ import annotations

import contextlib
import hashlib
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pftwin.file_limits import MESH_BYTES
from pftwin.kept import folder
from pftwin.kept.identity import CannotKeepError, digest, value_text
from pftwin.kept.plain import packed, unpacked
from pftwin.kept.reach import reach, source, versions

T = TypeVar("T")

_KIND = "values"


def kept(function: Callable[..., T], *args: Any, files: Sequence[Path]) -> T:
    """function(*args), or what it once gave for the same arguments, the same content of the files and the same code.

    The value must be plain (`plain.packed`; what is not is not kept) and depend on nothing else. What came with a
    warning is not kept, so that the warning comes again. Where no folder is chosen, and wherever a key cannot be made,
    the function is simply called.
    """
    key = _key(function, args, files)
    if key is None:
        return function(*args)
    body = folder.read(_KIND, key)
    if body is not None:
        with contextlib.suppress(Exception):  # whatever is wrong with it, it can be made anew
            return unpacked(body)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        value = function(*args)
    for w in warned:
        warnings.warn_explicit(w.message, w.category, w.filename, w.lineno)
    if not warned and _key(function, args, files) == key:  # the files are still those that were read
        with contextlib.suppress(CannotKeepError):  # not plain
            folder.write(_KIND, key, packed(value))
    return value


def _key(function: Callable[..., Any], args: tuple[Any, ...], files: Sequence[Path]) -> str | None:
    if folder.chosen() is None:
        return None
    try:
        contents = [_content(file) for file in files]
        return digest((source(), reach(function), versions(), value_text(args), *contents))
    except (CannotKeepError, OSError):
        return None


def _content(file: Path) -> str:
    if file.stat().st_size > MESH_BYTES:  # no reader takes it: that is for the reader to say
        raise CannotKeepError(f"{file} is too large")
    return hashlib.sha256(file.read_bytes()).hexdigest()
