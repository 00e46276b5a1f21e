"""Values as bytes that are data and nothing else: a text in JSON, and behind it the numbers of the arrays.

Reading cannot run code, as unpickling can: the text names types of pftwin's own, and of these only dataclasses, named
tuples and enumerations are made, by putting their fields in place without calling anything of theirs.
"""

from __future__ import annotations

import dataclasses
import enum
import importlib
import json
import math
import zlib
from pathlib import Path, PurePath
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pftwin.kept.identity import CannotKeepError, root, type_text

MOST_BYTES = 2_000_000_000  # of a value; the largest, a tree over two million triangles, takes half of it
_LENGTH = 8  # bytes that say how long the text is
_ALIGNED = 16  # arrays begin at multiples of it


def packed(value: Any) -> bytes:
    """A value of plain types, arrays, and pftwin's own dataclasses, named tuples and enumerations of these.

    Raises:
        CannotKeepError: something else is in it.
    """
    writer = _Writer()
    text = json.dumps(writer.node(value), separators=(",", ":")).encode()
    text += b" " * (-(len(text) + _LENGTH) % _ALIGNED)
    return zlib.compress(b"".join((len(text).to_bytes(_LENGTH, "little"), text, *writer.parts)), 1)


def unpacked(body: bytes) -> Any:
    """The value again, array for array and bit for bit.

    Raises:
        ValueError, TypeError, KeyError, IndexError, AttributeError, ImportError, zlib.error: bytes that `packed` did
            not make; nothing else happens.
    """
    unzip = zlib.decompressobj()
    content = unzip.decompress(body, MOST_BYTES)
    if not unzip.eof:
        raise ValueError("it is not whole, or too large")
    end = _LENGTH + int.from_bytes(content[:_LENGTH], "little")
    return _Reader(memoryview(content)[end:]).value(json.loads(content[_LENGTH:end]))


class _Writer:
    """Nodes are JSON's own numbers, texts, and lists [kind, ...]; what occurs twice is written once."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self._length = 0
        self._seen: dict[int, tuple[int, Any]] = {}  # with the object itself, so that no identity is given twice

    def node(self, value: Any) -> Any:
        kind = type(value)
        if value is None or kind in (bool, int, float, str):
            return value
        if id(value) in self._seen:
            return ["again", self._seen[id(value)][0]]
        made = self._made(value, kind)
        if made[0] in ("array", "number", "device", "weak", "fields"):  # as its reader counts
            self._seen[id(value)] = len(self._seen), value
        return made

    def _made(self, value: Any, kind: type) -> list[Any]:
        if kind in (list, tuple):
            return [kind.__name__, *map(self.node, value)]
        if kind is dict:
            return ["dict", *([self.node(k), self.node(v)] for k, v in value.items())]
        if kind is np.ndarray:
            return ["array", *self._numbers(value)]
        if isinstance(value, np.generic):
            return ["number", *self._numbers(np.asarray(value))]
        if isinstance(value, jax.Array):
            return self._of_jax(value)
        if isinstance(value, enum.Enum):
            return ["enum", _own_type(kind), value.name]
        if isinstance(value, PurePath):
            return ["path", str(value)]
        if isinstance(value, type):
            return ["type", _own_type(value)]
        if _is_named_tuple(kind):
            return ["named", _own_type(kind), *map(self.node, value)]
        if dataclasses.is_dataclass(kind):
            names = [f.name for f in dataclasses.fields(kind) if hasattr(value, f.name)]
            return ["fields", _own_type(kind), *([n, self.node(getattr(value, n))] for n in names)]
        raise CannotKeepError(f"a {kind.__module__}.{kind.__qualname__} is not plain")

    def _of_jax(self, value: jax.Array) -> list[Any]:
        if jnp.issubdtype(value.dtype, jax.dtypes.extended):
            raise CannotKeepError(f"an array of {value.dtype}")
        if not value.weak_type:
            return ["device", *self._numbers(np.asarray(value))]
        scalar = value.item() if value.ndim == 0 else None
        if scalar is None or jnp.asarray(scalar).aval != value.aval:
            raise CannotKeepError("an array of weak type")
        return ["weak", self.node(scalar)]

    def _numbers(self, array: np.ndarray[Any, Any]) -> tuple[str, list[int], int]:
        if array.dtype.kind not in "biufcUS" or array.dtype.hasobject:
            raise CannotKeepError(f"an array of {array.dtype}")
        data = array.tobytes()
        begins = self._length
        self.parts += [data, bytes(-len(data) % _ALIGNED)]
        self._length += len(data) + -len(data) % _ALIGNED
        return array.dtype.str, list(array.shape), begins


class _Reader:
    def __init__(self, numbers: memoryview) -> None:
        self._data, self._seen = numbers, []

    def value(self, node: Any) -> Any:
        if not isinstance(node, list):
            if isinstance(node, dict):
                raise ValueError("an object of JSON")
            return node
        kind, *rest = node
        if kind == "again":
            return self._seen[rest[0]]
        value = self._made(kind, rest)
        if kind in ("array", "number", "device", "weak", "fields"):
            self._seen.append(value)
        return value

    def _made(self, kind: str, rest: list[Any]) -> Any:
        if kind in ("list", "tuple"):
            return (list if kind == "list" else tuple)(map(self.value, rest))
        if kind == "dict":
            return {self.value(k): self.value(v) for k, v in rest}
        if kind == "array":
            return self._numbers(*rest)
        if kind == "number":
            return self._numbers(*rest)[()]
        if kind == "device":
            return jax.device_put(self._numbers(*rest))
        if kind == "weak":
            return jnp.asarray(rest[0])
        if kind == "enum":
            return _found(rest[0], enum.Enum)[rest[1]]
        if kind == "path":
            return Path(rest[0])
        if kind == "type":
            return _found(rest[0], object)
        if kind == "named":
            return tuple.__new__(_found(rest[0], tuple), map(self.value, rest[1:]))
        if kind == "fields":
            return self._fields(rest[0], rest[1:])
        raise ValueError(f"no kind {kind!r}")

    def _fields(self, name: str, fields: list[Any]) -> Any:
        kind: Any = _found(name, object)
        if not dataclasses.is_dataclass(kind):
            raise TypeError(f"{name} is no dataclass")
        known = {f.name for f in dataclasses.fields(kind)}
        made: Any = object.__new__(kind)  # pyright: ignore[reportArgumentType]
        for key, node in fields:
            if key not in known:
                raise KeyError(key)
            object.__setattr__(made, key, self.value(node))
        return made

    def _numbers(self, kind: str, shape: list[int], begins: int) -> np.ndarray[Any, Any]:
        dtype = np.dtype(kind)
        if dtype.kind not in "biufcUS":
            raise TypeError(kind)
        count = math.prod(shape)
        if not all(isinstance(n, int) and n >= 0 for n in shape):
            raise ValueError(f"the shape {shape}")
        return (
            np.frombuffer(self._data, dtype, count, begins).reshape(shape).copy() if count else np.empty(shape, dtype)
        )


def _own_type(kind: type) -> str:
    if root(kind.__module__) != "pftwin":
        raise CannotKeepError(f"{kind.__module__}.{kind.__qualname__} is not pftwin's own")
    return f"{kind.__module__}:{type_text(kind).removeprefix(kind.__module__ + '.')}"


def _found(name: str, base: type) -> Any:
    """The type of pftwin's of that name; a module of pftwin's is imported for it, no other."""
    module, _, path = name.partition(":")
    if root(module) != "pftwin":
        raise TypeError(f"{module} is not pftwin's own")
    found: Any = importlib.import_module(module)
    for part in path.split("."):
        found = vars(found)[part]
    if not (isinstance(found, type) and issubclass(found, base) and found.__module__ == module):
        raise TypeError(f"{name} is no such type")
    return found


def _is_named_tuple(kind: type) -> bool:
    return issubclass(kind, tuple) and hasattr(kind, "_fields")
