"""Text that two processes agree on for values, types and structures; a refusal where they might not.

What is kept is found by such text. Two different things must never have the same, so whatever is not known to be told
apart is refused, and then nothing is kept.
"""

from __future__ import annotations

import dataclasses
import enum
import hashlib
import sys
from collections.abc import Iterable
from typing import Any

import numpy as np

# Whose versions are part of every key, so that their code need not be.
LIBRARIES = frozenset(
    (
        "annotated_types", "diffrax", "equinox", "ezc3d", "jax", "jaxlib", "jaxtyping", "numpy", "optax", "optimistix",
        "pydantic", "pydantic_core", "scipy", "trimesh", "typing_extensions",
    )
)  # fmt: skip


class CannotKeepError(Exception):
    """Something decides an answer that cannot be told apart from something else in another process."""


def digest(parts: Iterable[str]) -> str:
    """One hash of several texts."""
    total = hashlib.sha256()
    for part in parts:
        data = part.encode()
        total.update(len(data).to_bytes(8, "little") + data)
    return total.hexdigest()


def root(module: str | None) -> str:
    """The package that a module belongs to."""
    return (module or "").partition(".")[0]


def is_library(module: str | None) -> bool:
    """Whether a module is Python's own or of a library whose version is part of every key."""
    return root(module) in LIBRARIES or root(module) in sys.stdlib_module_names


def type_text(kind: type) -> str:
    """A type of pftwin, of a library or of Python, that is found by its name.

    Raises:
        CannotKeepError: a type from elsewhere: its code is not part of the key.
    """
    if root(kind.__module__) != "pftwin" and not is_library(kind.__module__):
        raise CannotKeepError(f"{kind.__module__}.{kind.__qualname__} is not pftwin's own")
    found: Any = sys.modules.get(kind.__module__)
    for name in kind.__qualname__.split("."):
        found = getattr(found, name, None)
    if found is not kind and kind is not type(None):
        raise CannotKeepError(f"{kind.__module__}.{kind.__qualname__} is not the type of that name")
    return f"{kind.__module__}.{kind.__qualname__}"


def value_text(value: Any) -> str:
    """A plain value, type and content.

    Raises:
        CannotKeepError: not a plain value.
    """
    kind: Any = type(value)
    if value is None or kind in (bool, int, str, bytes, complex):
        return f"{kind.__name__} {value!r}"
    if kind is float:
        return f"float {value.hex()}"
    if isinstance(value, type):
        return f"type {type_text(value)}"
    if isinstance(value, enum.Enum):
        return f"{type_text(kind)} {value.name} {value.value!r}"
    if issubclass(kind, np.ndarray | np.generic) and value.dtype != object:
        content = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return f"{kind.__name__} {value.dtype.str} {value.shape} {content}"
    if issubclass(kind, tuple | list):
        return f"{type_text(kind)} [{', '.join(value_text(v) for v in value)}]"
    if kind is dict:
        return f"dict {{{', '.join(f'{value_text(k)}: {value_text(v)}' for k, v in value.items())}}}"
    if kind in (set, frozenset):
        return f"{kind.__name__} {{{', '.join(sorted(value_text(v) for v in value))}}}"
    if dataclasses.is_dataclass(kind) and root(kind.__module__) == "pftwin":
        fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(kind)}
        return f"{type_text(kind)} {value_text(fields)}"
    if root(kind.__module__) == "equinox" and repr(value) == "Missing":  # a static field without a value
        return "Missing"
    raise CannotKeepError(f"no text for a {kind.__module__}.{kind.__qualname__}")


def structure_text(structure: Any) -> str:
    """A pytree's structure with all that is static in it.

    Raises:
        CannotKeepError: a node or a static value from outside pftwin and its libraries.
    """
    data = structure.node_data()
    if data is None:
        return "*" if structure.num_leaves else "None"
    kind, static = data
    inner = ", ".join(structure_text(child) for child in structure.children())
    return f"{type_text(kind)} {value_text(static)} ({inner})"


def node_types(structure: Any) -> set[type]:
    """The types of all nodes."""
    data = structure.node_data()
    found = set() if data is None else {data[0]}
    for child in structure.children():
        found |= node_types(child)
    return found
