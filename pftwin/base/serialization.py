"""Values as bytes that are data and nothing else: NumPy's npz, with a text in JSON for all that is no array.

Reading runs no code, as unpickling would: the text names types of pftwin, and of these only dataclasses, named tuples
and enumerations are made, by putting their fields in place without calling anything of theirs.
"""

from __future__ import annotations

import dataclasses
import enum
import hashlib
import importlib
import io
import json
from pathlib import Path, PurePath
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

_NUMBERS = "biufcUS"  # kinds of NumPy's types that are plain data


class NotPlainError(Exception):
    """A value that cannot be written down as data, or told apart from another one in another process."""


def packed(value: Any) -> bytes:
    """A value of plain types, arrays, and pftwin's own dataclasses, named tuples and enumerations of these.

    Raises:
        NotPlainError: it holds something else.
    """
    arrays: list[np.ndarray] = []
    text = json.dumps(_node(value, arrays))
    file = io.BytesIO()
    np.savez(file, np.frombuffer(text.encode(), np.uint8), *arrays)
    return file.getvalue()


def unpacked(body: bytes) -> Any:
    """The value again, array for array and bit for bit.

    Raises:
        Exception: bytes that `packed` did not make or that were damaged; nothing else happens.
    """
    with np.load(io.BytesIO(body), allow_pickle=False) as file:
        arrays = [file[f"arr_{i}"] for i in range(len(file.files))]
    return _value(json.loads(arrays[0].tobytes()), arrays)


def fingerprint(value: Any) -> str:
    """A hash that differs for values that differ, in content or in type. Of a `jax.ShapeDtypeStruct` shape and type.

    Raises:
        NotPlainError: as `packed`.
    """
    arrays: list[np.ndarray] = []
    total = hashlib.sha256(json.dumps(_node(value, arrays)).encode())
    for a in arrays:
        total.update(f" {a.dtype.str} {a.shape} ".encode() + a.tobytes())
    return total.hexdigest()


def _node(value: Any, arrays: list[np.ndarray]) -> Any:
    """What JSON has for it: its own numbers and texts, and for all else a list [kind, ...]."""
    kind = type(value)
    if value is None or kind in (bool, int, float, str):
        return value
    if kind in (list, tuple):
        return [kind.__name__, *(_node(v, arrays) for v in value)]
    if kind is dict:
        return ["dict", *([_node(k, arrays), _node(v, arrays)] for k, v in value.items())]
    if isinstance(value, jax.Array) and getattr(value, "weak_type", False):  # a random key has none
        if value.ndim or jnp.asarray(value.item()).dtype != value.dtype:
            raise NotPlainError("an array of weak type")
        return ["weak", value.item()]
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        if jnp.issubdtype(value.dtype, jax.dtypes.extended) or value.dtype.kind not in _NUMBERS:
            raise NotPlainError(f"an array of {value.dtype}")
        arrays.append(np.asarray(value))
        kinds = {"device": jax.Array, "array": np.ndarray, "number": np.generic}
        return [next(name for name, of in kinds.items() if isinstance(value, of)), len(arrays)]
    if isinstance(value, enum.Enum):
        return ["enum", _name_of(kind), value.name]
    if isinstance(value, PurePath):
        return ["path", str(value)]
    if isinstance(value, jax.ShapeDtypeStruct):
        return ["shape", list(value.shape), value.dtype.str, value.weak_type]
    if isinstance(value, tuple):
        return ["named", _name_of(kind), *(_node(v, arrays) for v in value)]
    if dataclasses.is_dataclass(kind):
        names = [f.name for f in dataclasses.fields(kind) if hasattr(value, f.name)]
        return ["fields", _name_of(kind), *([n, _node(getattr(value, n), arrays)] for n in names)]
    raise NotPlainError(f"a {kind.__module__}.{kind.__qualname__}")


def _value(node: Any, arrays: list[np.ndarray]) -> Any:
    if not isinstance(node, list):
        return node
    kind, *rest = node
    if kind in ("list", "tuple"):
        return (list if kind == "list" else tuple)(_value(n, arrays) for n in rest)
    if kind == "dict":
        return {_value(k, arrays): _value(v, arrays) for k, v in rest}
    if kind in ("array", "number", "device"):
        array = arrays[rest[0]]
        return array if kind == "array" else array[()] if kind == "number" else jax.device_put(array)
    if kind == "weak":
        return jnp.asarray(rest[0])
    if kind == "path":
        return Path(rest[0])
    if kind == "enum":
        return _type(rest[0], enum.Enum)[rest[1]]
    if kind == "named":
        return tuple.__new__(_type(rest[0], tuple), (_value(n, arrays) for n in rest[1:]))
    if kind != "fields":
        raise ValueError(f"no kind {kind!r}")
    made_of: Any = _type(rest[0], object)
    known = {f.name for f in dataclasses.fields(made_of)}
    made = object.__new__(made_of)
    for name, inner in rest[1:]:
        if name not in known:
            raise KeyError(name)
        object.__setattr__(made, name, _value(inner, arrays))
    return made


def _name_of(kind: type) -> str:
    """Module and name of a type of pftwin's.

    Raises:
        NotPlainError: a type from elsewhere, or one that is not found by its name.
    """
    if kind.__module__.partition(".")[0] != "pftwin" or "<locals>" in kind.__qualname__:
        raise NotPlainError(f"{kind.__module__}.{kind.__qualname__} is not pftwin's own")
    return f"{kind.__module__}:{kind.__qualname__}"


def _type(name: str, base: type) -> Any:
    """The type of pftwin's of that name; a module of pftwin's is imported for it, no other."""
    module, _, path = name.partition(":")
    if module.partition(".")[0] != "pftwin":
        raise TypeError(f"{module} is not pftwin's own")
    found: Any = importlib.import_module(module)
    for part in path.split("."):
        found = vars(found)[part]
    if not (isinstance(found, type) and issubclass(found, base) and found.__module__ == module):
        raise TypeError(f"{name} is no such type")
    return found
