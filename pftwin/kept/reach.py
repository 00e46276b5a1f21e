"""The code that an answer comes from: pftwin's source, and whether what is loaded is still what the source says.

A program runs with whatever names stand for while it is traced. Someone may have set `equilibrium.REACH` to another
value, or put a function of their own into `INTEGRATORS`: `reach` follows the names that functions look up and writes
down the constants and functions found there.
"""

from __future__ import annotations

import hashlib
import os
import types
from collections.abc import Iterator
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import pftwin
from pftwin.kept.identity import LIBRARIES, CannotKeepError, is_library, root, type_text, value_text


@cache
def versions() -> str:
    """Of the libraries that numbers come from."""
    found = []
    for name in sorted(LIBRARIES):
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    return ", ".join(found)


def source() -> str:
    """A hash of pftwin's source files.

    Raises:
        CannotKeepError: they cannot be read, or one changed after this process had begun to import them.
    """
    try:
        newest = max((entry.stat().st_mtime, entry.path) for entry in _files(pftwin.__path__[0]))
        if newest[0] > pftwin.imported_at:
            raise CannotKeepError(f"{newest[1]} changed after this process began")
        return _source_hash()
    except (OSError, ValueError) as error:
        raise CannotKeepError(f"the source cannot be read: {error}") from error


def _files(folder: str) -> Iterator[os.DirEntry[str]]:
    for entry in os.scandir(folder):
        if entry.is_dir():
            yield from _files(entry.path)
        elif entry.name.endswith(".py"):
            yield entry


@cache
def _source_hash() -> str:
    folder, total = pftwin.__path__[0], hashlib.sha256()
    for path in sorted(entry.path for entry in _files(folder)):
        content = Path(path).read_bytes()
        total.update(f"{os.path.relpath(path, folder)} {len(content)} ".encode() + content)
    return total.hexdigest()


def reach(*roots: Any) -> str:
    """The functions and constants that pftwin's code looks up, starting at these functions and types.

    Raises:
        CannotKeepError: it gets to code from outside pftwin and its libraries.
    """
    seen: dict[int, Any] = {}  # holds what it has seen, so that no identity is given twice
    waiting, lines = [("", r) for r in reversed(roots)], []
    while waiting:
        name, value = waiting.pop()
        if id(value) in seen:
            continue
        text, inner = _looked_at(value)
        if text is None:
            continue
        lines.append(f"{name} = {text}")
        if inner is not None:
            seen[id(value)] = value
            waiting += reversed(list(inner))
    return "\n".join(lines)


Named = tuple[str, Any]


def _looked_at(value: Any) -> tuple[str | None, Iterator[Named] | None]:
    """Its text (None: of no account) and what to look at next."""
    kind = type(value)
    if isinstance(value, types.ModuleType):
        return (None, None) if is_library(value.__name__) else (f"module {_own(value.__name__)}", None)
    if isinstance(value, types.FunctionType):
        if is_library(value.__module__):  # it may hold a function of pftwin's: a decorator's wrapper
            return f"{value.__module__}.{value.__qualname__}", (c for c in _closure(value) if _has_code(c[1]))
        return f"{_own(value.__module__)}.{value.__qualname__}", _names(value)
    if isinstance(value, type):
        return type_text(value), _members(value) if root(value.__module__) == "pftwin" else None
    if isinstance(value, dict):
        return "dict", ((_text(k), v) for k, v in value.items())
    if isinstance(value, tuple | list):
        return type_text(kind), ((str(i), v) for i, v in enumerate(value))
    if isinstance(value, property):
        return "property", (("", f) for f in (value.fget, value.fset) if f is not None)
    if isinstance(value, staticmethod | classmethod):
        return kind.__name__, iter([("", value.__func__)])
    try:
        return value_text(value), None
    except CannotKeepError:
        if not is_library(kind.__module__) and root(kind.__module__) != "pftwin":
            raise
    if isinstance(value, types.BuiltinFunctionType):
        return value.__qualname__, None
    # A library's wrapper around functions (jit, custom derivatives) or types (a union), or an object of our own.
    inside = {**getattr(value, "__dict__", {}), "args": getattr(value, "__args__", ())}
    return f"{kind.__module__}.{kind.__qualname__}", ((k, v) for k, v in inside.items() if v and _has_code(v))


def _has_code(value: Any) -> bool:
    return callable(value) or isinstance(value, tuple)


def _own(module: str) -> str:
    if root(module) != "pftwin":
        raise CannotKeepError(f"{module} is not pftwin's own")
    return module


def _text(key: Any) -> str:
    return type_text(key) if isinstance(key, type) else str(key)


def _names(function: types.FunctionType) -> Iterator[Named]:
    """What a function's code may look up: globals, attributes of pftwin's modules, closure and defaults."""
    for name in _code_names(function.__code__):
        value = function.__globals__.get(name, _NOTHING)
        if value is _NOTHING:
            continue
        yield name, value
        if isinstance(value, types.ModuleType) and root(value.__name__) == "pftwin":
            yield from ((n, vars(value)[n]) for n in function.__code__.co_names if n in vars(value))
    yield from _closure(function)
    yield from ((f"default {i}", d) for i, d in enumerate(function.__defaults__ or ()))
    yield from (function.__kwdefaults__ or {}).items()


def _closure(function: types.FunctionType) -> Iterator[Named]:
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            yield name, cell.cell_contents
        except ValueError:  # not filled yet
            continue


_NOTHING = object()


def _code_names(code: types.CodeType) -> Iterator[str]:
    yield from code.co_names
    for inner in code.co_consts:
        if isinstance(inner, types.CodeType):
            yield from _code_names(inner)


def _members(kind: type) -> Iterator[Named]:
    """Methods and constants of a type and of its bases in pftwin."""
    for base in kind.__mro__:
        if root(base.__module__) != "pftwin":
            continue
        for name, value in vars(base).items():
            special = name.startswith("__") and name.endswith("__")
            if special and not isinstance(value, types.FunctionType):
                continue
            if not name.startswith("_abc_"):
                yield name, value
