"""Declarations of unit, bounds and short name for the parameters of an effect, as metadata of its fields.

    stiffness: Scalar = eqx.field(metadata=quantity("N/m", positive=True, alias="K"))

Checks, fits, scene files and reports depend on the declaration, never on a field's name. A declaration applies to
everything inside its field that has no declaration, e.g. to the three components of a vector.
"""

from __future__ import annotations

import dataclasses
from functools import lru_cache
from typing import Any, NamedTuple, get_type_hints

import jax
import numpy as np

_KEY = "quantity"


class Quantity(NamedTuple):
    """Declaration of a physical quantity."""

    unit: str  # "" if dimensionless
    lower: float = -np.inf  # smallest allowed value
    upper: float = np.inf  # largest allowed value
    positive: bool = False  # whether 0 is excluded
    alias: str = ""  # symbol in papers; with the number of the line element it is a short name, such as K1
    frame: str = ""  # frame of a point: "patella", or "body" for that of the effect's field `body`
    words: str = ""  # description for readers; empty if the field's name suffices

    @property
    def bounded(self) -> bool:
        """Whether the declaration restricts the values."""
        return self.positive or self.lower > -np.inf or self.upper < np.inf

    @property
    def expected(self) -> str:
        """The allowed values, in words."""
        if self.positive and self.upper == np.inf:
            return "a positive number"
        if self.lower == 0 and self.upper == np.inf:
            return "zero or a positive number"
        low = "" if self.lower == -np.inf and not self.positive else f"{'above' if self.positive else 'at least'} "
        low = f"{low}{max(self.lower, 0.0) if self.positive else self.lower:g}" if low else ""
        high = "" if self.upper == np.inf else f"at most {self.upper:g}"
        return " and ".join(words for words in (low, high) if words)

    def holds(self, values: Any) -> Any:
        """Whether each value is allowed; values may be traced."""
        low = values > 0 if self.positive else values >= self.lower
        return low & (values >= self.lower) & (values <= self.upper)

    def offender(self, values: np.ndarray) -> float | None:
        """The smallest or largest value if it is out of bounds, else None. Ignores NaN."""
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
    """A leaf of a pytree with its declaration."""

    path: tuple[str, ...]  # field names and item indices
    leaf: Any
    quantity: Quantity | None


def declarations(value: Any) -> list[Declared]:
    """All leaves of a pytree, in JAX's order, each with the nearest declaration above it."""
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
    """Name of one step in a pytree's path: a field's name, an item's index or a key."""
    return str(getattr(key, "name", getattr(key, "idx", getattr(key, "key", key))))


def declared_field(owner: type, name: str) -> Quantity | None:
    """Declaration of a class's field; None if there is none."""
    if not dataclasses.is_dataclass(owner):
        return None
    found = next((f for f in dataclasses.fields(owner) if f.name == name), None)
    return None if found is None else found.metadata.get(_KEY)


@lru_cache(maxsize=64)
def bounded_leaves(structure: Any) -> tuple[tuple[Quantity, tuple[int, ...]], ...]:
    """Indices of the bounded leaves in a pytree of this structure, grouped by declaration."""
    groups: dict[Quantity, list[int]] = {}
    for number, (_, found) in enumerate(_declared(structure)):
        if found is not None and found.bounded:
            groups.setdefault(found, []).append(number)
    return tuple((declared, tuple(numbers)) for declared, numbers in groups.items())


_READ = {"m": (1e3, "mm"), "rad": (180 / np.pi, "deg"), "m^2": (1e6, "mm^2"), "Pa": (1e-6, "MPa")}


def as_read(unit: str, *, percent: bool = False) -> tuple[float, str]:
    """Factor and unit for display: metres in mm (areas in mm^2), pressures in MPa, radians in degrees and, with
    `percent`, dimensionless fractions (unit "1") in %; others unchanged."""
    return (100.0, "%") if percent and unit == "1" else _READ.get(unit, (1.0, unit))


def shown(value: float, unit: str, digits: int) -> str:
    """Formats a number in the unit of `as_read`, with `digits` significant digits."""
    scale, display_unit = as_read(unit)
    return f"{scale * value:.{digits}g} {display_unit}".removesuffix(" 1")


def about(unit: str, long_name: str) -> dict[str, str]:
    """CF attributes of a dataset's variable: its unit ("1" if dimensionless) and long name."""
    return {"units": unit, "long_name": long_name}


def netcdf_attribute(value: Any) -> int | float | str:
    """Converts a value to a type that NetCDF can store: int, float or str."""
    if isinstance(value, bool):
        return int(value)
    return value if isinstance(value, int | float | str) else str(value)


def annotated(kind: type) -> dict[str, tuple[Any, ...]]:
    """What fields of a class are annotated with, by name: `force: Annotated[float, "N", "contact force"]`."""
    hints = get_type_hints(kind, include_extras=True)
    return {name: hint.__metadata__ for name, hint in hints.items() if hasattr(hint, "__metadata__")}
