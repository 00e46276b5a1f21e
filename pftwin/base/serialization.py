"""Serialization of values as data: NumPy's npz format for arrays, and JSON for everything else.

Unlike unpickling, reading executes no code from the data: the JSON names types of pftwin and fitting, and only
dataclasses and named tuples among them are created, by setting their fields without calling their methods.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib
import io
import json
from pathlib import Path, PurePath
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

PACKAGES = ("pftwin", "fitting")  # whose types and functions are stored and identified by name
_ARRAYS = {"device": jax.Array, "array": np.ndarray, "number": np.generic}


class NotPlainError(Exception):
    """The value cannot be serialized as data, or not identified in another process."""


def to_bytes(value: Any) -> bytes:
    """Serializes a value of plain types, arrays, and dataclasses and named tuples of `PACKAGES` of these.

    Raises:
        NotPlainError: the value contains something else.
    """
    arrays: list[np.ndarray] = []
    text = json.dumps(_node(value, arrays))
    file = io.BytesIO()
    np.savez(file, np.frombuffer(text.encode(), np.uint8), *arrays)
    return file.getvalue()


def from_bytes(body: bytes) -> Any:
    """Inverse of `to_bytes`; arrays are identical bit for bit.

    Raises:
        Exception: the bytes are damaged or not from `to_bytes`; no code from them is executed.
    """
    with np.load(io.BytesIO(body), allow_pickle=False) as file:
        arrays = [file[f"arr_{i}"] for i in range(len(file.files))]
    return _value(json.loads(arrays[0].tobytes()), arrays)


def fingerprint(value: Any) -> str:
    """Hash of a value's content and types; for a `jax.ShapeDtypeStruct`, of its shape and type.

    Raises:
        NotPlainError: as `to_bytes`.
    """
    return hashlib.sha256(to_bytes(value)).hexdigest()


def _node(value: Any, arrays: list[np.ndarray]) -> Any:
    """JSON of a value: numbers and strings unchanged, anything else as a list [kind, ...]."""

    def inner(values: Any) -> list[Any]:
        return [_node(v, arrays) for v in values]

    kind = type(value)
    if value is None or kind in (bool, int, float, str):
        return value
    if kind in (list, tuple):
        return [kind.__name__, *inner(value)]
    if kind is dict:
        return ["dict", inner(value), inner(value.values())]
    if isinstance(value, tuple(_ARRAYS.values())):
        weak = getattr(value, "weak_type", False)  # the weak type would be lost; random keys have no such attribute
        if weak or jnp.issubdtype(value.dtype, jax.dtypes.extended) or value.dtype.kind not in "biufcUS":
            raise NotPlainError(f"an array of {'weak ' if weak else ''}{value.dtype}")
        arrays.append(np.asarray(value))
        return [next(name for name, of in _ARRAYS.items() if isinstance(value, of)), len(arrays)]
    if isinstance(value, PurePath):
        return ["path", str(value)]
    if isinstance(value, jax.ShapeDtypeStruct):
        return ["shape", list(value.shape), value.dtype.str, value.weak_type]
    if isinstance(value, tuple):
        return ["named", _name_of(kind), *inner(value)]
    if dataclasses.is_dataclass(kind):
        names = [f.name for f in dataclasses.fields(kind) if hasattr(value, f.name)]
        return ["fields", _name_of(kind), names, inner(getattr(value, n) for n in names)]
    raise NotPlainError(f"a {kind.__module__}.{kind.__qualname__}")


def _value(node: Any, arrays: list[np.ndarray]) -> Any:
    def inner(nodes: Any) -> list[Any]:
        return [_value(n, arrays) for n in nodes]

    match node:
        case ["list", *items]:
            return inner(items)
        case ["tuple", *items]:
            return tuple(inner(items))
        case ["dict", keys, values]:
            return dict(zip(inner(keys), inner(values), strict=True))
        case ["device" | "array" | "number" as kind, place]:
            return {"device": jax.device_put, "array": np.asarray, "number": lambda a: a[()]}[kind](arrays[place])
        case ["path", text]:
            return Path(text)
        case ["named", name, *items]:
            return tuple.__new__(_type(name, tuple), inner(items))
        case ["fields", name, names, items]:
            made = object.__new__(_type(name, object))
            if not {f.name for f in dataclasses.fields(made)}.issuperset(names):
                raise KeyError(name)
            for field, value in zip(names, inner(items), strict=True):
                object.__setattr__(made, field, value)
            return made
        case list():
            raise ValueError(f"no kind of value: {node[:1]}")
    return node


def _name_of(kind: type) -> str:
    name = f"{kind.__module__}:{kind.__qualname__}"
    try:
        _type(name, kind)
    except (TypeError, KeyError):
        raise NotPlainError(f"{name} belongs to another package") from None
    return name


def _type(name: str, base: type) -> Any:
    """The type named "MODULE:NAME" in one of `PACKAGES`; imports only modules of these."""
    module, _, own = name.partition(":")
    if module.partition(".")[0] not in PACKAGES:
        raise TypeError(f"{module} belongs to another package")
    found = vars(importlib.import_module(module))[own]
    if not (isinstance(found, type) and issubclass(found, base) and found.__module__ == module):
        raise TypeError(f"{name} is no such type")
    return found
