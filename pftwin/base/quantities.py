"""Declarations of an effect's numbers: unit, bounds and short name, beside each field.

    stiffness: Scalar = eqx.field(metadata=quantity("N/m", positive=True, alias="K"))

Checks, fits, scene files and reports read the declaration; none of them goes by a field's name. A
declaration holds for everything below its field that has none of its own: that of a vector for its three components.
"""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import numpy as np

_KEY = "quantity"


class Quantity(NamedTuple):
    """A physical quantity as a field declares it."""

    unit: str  # "" for a pure number
    lower: float = -np.inf  # smallest meaningful value
    upper: float = np.inf  # largest
    positive: bool = False  # whether 0 is excluded
    alias: str = ""  # symbol in papers: with the number of its line element a short name, such as K1
    frame: str = ""  # of a point: "patella", or "body" for that of the effect's field `body`
    words: str = ""  # for readers; empty where the field's name says it

    @property
    def bounded(self) -> bool:
        """Whether the declaration restricts the numbers."""
        return self.positive or self.lower > -np.inf or self.upper < np.inf

    @property
    def expected(self) -> str:
        """The allowed numbers, in words."""
        if self.positive and self.upper == np.inf:
            return "a positive number"
        if self.lower == 0 and self.upper == np.inf:
            return "zero or a positive number"
        low = "" if self.lower == -np.inf and not self.positive else f"{'above' if self.positive else 'at least'} "
        low = f"{low}{max(self.lower, 0.0) if self.positive else self.lower:g}" if low else ""
        high = "" if self.upper == np.inf else f"at most {self.upper:g}"
        return " and ".join(words for words in (low, high) if words)

    def holds(self, values: Any) -> Any:
        """Whether each of the values is allowed; they may be traced."""
        low = values > 0 if self.positive else values >= self.lower
        return low & (values >= self.lower) & (values <= self.upper)

    def offender(self, values: np.ndarray) -> float | None:
        """The value farthest out of bounds; None if all are allowed. NaN is not judged here."""
        if values.size == 0:
            return None
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        if low < self.lower or (self.positive and low <= 0):
            return low
        return high if high > self.upper else None


def quantity(
    unit: str,
    *,
    positive: bool = False,
    at_least: float = -np.inf,
    at_most: float = np.inf,
    alias: str = "",
    frame: str = "",
    words: str = "",
) -> dict[str, Any]:
    """Metadata for `eqx.field`: see `Quantity`."""
    return {_KEY: Quantity(unit, max(at_least, 0.0) if positive else at_least, at_most, positive, alias, frame, words)}


class Declared(NamedTuple):
    """A leaf of a value with what is declared of it."""

    path: tuple[str, ...]  # names of fields, and numbers of items
    leaf: Any
    quantity: Quantity | None


def declarations(value: Any) -> list[Declared]:
    """All leaves of a pytree, in JAX's order, with the nearest declaration above each."""
    leaves, structure = jax.tree.flatten(value)
    return [Declared(path, leaf, found) for leaf, (path, found) in zip(leaves, _declared(structure), strict=True)]


@lru_cache(maxsize=256)
def _declared(structure: Any) -> tuple[tuple[tuple[str, ...], Quantity | None], ...]:
    """Path and nearest declaration of each leaf of a pytree of this structure."""
    whole = jax.tree.unflatten(structure, range(structure.num_leaves))
    return tuple(_declared_at(whole, keys) for keys, _ in jax.tree_util.tree_leaves_with_path(whole))


def _declared_at(root: Any, keys: tuple[Any, ...]) -> tuple[tuple[str, ...], Quantity | None]:
    at, path, nearest = root, [], None
    for key in keys:
        name = key_name(key)
        nearest = declared_field(type(at), name) or nearest
        at = getattr(at, name) if hasattr(key, "name") else at[key.idx if hasattr(key, "idx") else key.key]
        path.append(name)
    return tuple(path), nearest


def key_name(key: Any) -> str:
    """The name of one step in a pytree's path: of a field, an item's number, a key."""
    return str(getattr(key, "name", getattr(key, "idx", getattr(key, "key", key))))


def declared_field(owner: type, name: str) -> Quantity | None:
    """What a class declares of its field."""
    if not dataclasses.is_dataclass(owner):
        return None
    found = next((f for f in dataclasses.fields(owner) if f.name == name), None)
    return None if found is None else found.metadata.get(_KEY)


@lru_cache(maxsize=64)
def bounded_leaves(structure: Any) -> tuple[tuple[Quantity, tuple[int, ...]], ...]:
    """Numbers of the leaves of a pytree of this structure that have bounds, by their declaration."""
    groups: dict[Quantity, list[int]] = {}
    for number, (_, found) in enumerate(_declared(structure)):
        if found is not None and found.bounded:
            groups.setdefault(found, []).append(number)
    return tuple((declared, tuple(numbers)) for declared, numbers in groups.items())


_READ = {"m": (1e3, "mm"), "rad": (180 / np.pi, "deg")}


def as_read(unit: str, *, percent: bool = False) -> tuple[float, str]:
    """What a number of a unit is multiplied by for people, and the unit then: millimetres and degrees; `percent`: of
    pure numbers too, which are shares."""
    return (100.0, "%") if percent and unit == "1" else _READ.get(unit, (1.0, unit))


def shown(value: float, unit: str, digits: int) -> str:
    """A number in the unit that people read, with so many digits."""
    scale, told = as_read(unit)
    return f"{scale * value:.{digits}g} {told}".removesuffix(" 1")


def about(unit: str, long_name: str) -> dict[str, str]:
    """Attributes of a variable in a dataset by the CF conventions: its unit, "1" for a pure number, and its name."""
    return {"units": unit, "long_name": long_name}
