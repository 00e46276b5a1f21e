"""Base class of all tables of a scene file: strict fields with units in their names, lengths in m or mm."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, model_validator
from pydantic_core import PydanticCustomError


@dataclass
class ValidationRecords:
    """Records of a validation for its messages, by the identity of the file's values."""

    models: dict[int, type[Section]] = field(default_factory=dict)
    wrapped: set[int] = field(default_factory=set)
    originals: dict[int, tuple[Any, Any]] = field(default_factory=dict)  # by id: a value in metres, and as written


class Section(BaseModel):
    """A table. Unknown fields are errors; a field NAME_m may be written NAME_mm; strings never count as numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, populate_by_name=False)

    @model_validator(mode="before")
    @classmethod
    def _lengths_in_metres(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, dict):
            return data
        if isinstance(info.context, ValidationRecords):
            info.context.models[id(data)] = cls
        out = dict(data)
        for name in cls.model_fields:
            if (other := other_unit(name)) is not None and other[0] in out:
                label, factor = other
                if name in out:
                    raise problem(f"both {name} and {label} are given", expected="one of them")
                written = out.pop(label)
                out[name] = _scaled(written, factor)
                if isinstance(info.context, ValidationRecords):
                    info.context.originals[id(out[name])] = out[name], written
        return out

    @model_validator(mode="after")
    def _checked(self) -> Self:
        self._check()
        return self

    def _check(self) -> None:
        """Checks the consistency of the fields; subclasses raise a `problem`."""


def other_unit(name: str) -> tuple[str, float] | None:
    """Name of a field's variant in millimetres, and the factor to metres; None for fields without metres.

    The factor of quantities per metre, such as a stiffness in N/m, is 1000.
    """
    return (f"{name}m", 1e3 if name.endswith("_per_m") else 1e-3) if name.endswith("_m") else None


def problem(found: str, *, expected: str | None = None, remedy: str | None = None) -> PydanticCustomError:
    """Makes an error for validators to raise, which keeps its parts."""
    return PydanticCustomError("scene", "{found}", {"found": found, "expected": expected, "remedy": remedy})


def _scaled(value: Any, factor: float) -> Any:
    if isinstance(value, bool):
        return value
    if isinstance(value, int | float):
        return value * factor
    if isinstance(value, list):
        return [_scaled(v, factor) for v in value]
    if isinstance(value, dict):
        return {key: _scaled(v, factor) for key, v in value.items()}
    return value


def _unit_quaternion(value: list[float]) -> list[float]:
    norm = float(np.linalg.norm(value))
    if abs(norm - 1) > 1e-3:
        raise problem(
            f"found a quaternion of length {norm:.6g}",
            expected="a unit quaternion (w, x, y, z)",
            remedy="check the order of the four numbers: the scalar part comes first",
        )
    return [v / norm for v in value]


def _polynomial(value: str) -> str:
    if not re.fullmatch(r"[Pp]?([1-9]|1[0-2])", value):
        raise problem(f"found {value!r}", expected='a polynomial, "P1" to "P12"')
    return value


def _direction(value: list[float]) -> list[float]:
    if not any(value):
        raise problem("found the zero vector", expected="a direction: three numbers, not all zero")
    return value


def _one_or_many(value: Any, info: ValidationInfo) -> Any:
    if isinstance(value, list) and (not value or isinstance(value[0], dict)):
        return value
    return _wrapped(value, info)


def one_number_or_many(value: Any, info: ValidationInfo) -> Any:
    """Returns a list unchanged, a single value as a list of one."""
    return value if isinstance(value, list) else _wrapped(value, info)


def _printable(text: str) -> str:
    if not text.isprintable():
        raise problem(f"found {text[:60]!r}", expected="a name of printable characters")
    return text


def _point_or_points(value: Any, info: ValidationInfo) -> Any:
    if isinstance(value, list) and value and isinstance(value[0], list):
        return value
    return _wrapped(value, info)


def _wrapped(value: Any, info: ValidationInfo) -> list[Any]:
    if isinstance(info.context, ValidationRecords) and isinstance(value, list | dict):
        _, written = info.context.originals.get(id(value), (value, value))
        info.context.wrapped.add(id(written))
    return [value]


Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Point = Annotated[list[float], Field(min_length=3, max_length=3)]
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
PositivePair = Annotated[list[Positive], Field(min_length=2, max_length=2)]
PositiveTriple = Annotated[list[Positive], Field(min_length=3, max_length=3)]
Direction = Annotated[Point, AfterValidator(_direction)]
UnitQuaternion = Annotated[list[float], Field(min_length=4, max_length=4), AfterValidator(_unit_quaternion)]
Polynomial = Annotated[str, AfterValidator(_polynomial)]
LengthUnit = Literal["m", "dm", "cm", "mm", "um", "in"]
FileName = Annotated[str, Field(min_length=1), AfterValidator(_printable)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
# Fields of groups: one value for all members, or a list with one for each.
Positives = Annotated[list[Positive], Field(min_length=1), BeforeValidator(one_number_or_many)]
NotNegatives = Annotated[list[NotNegative], Field(min_length=1), BeforeValidator(one_number_or_many)]
Points = Annotated[list[Point], Field(min_length=1), BeforeValidator(_point_or_points)]
Directions = Annotated[list[Direction], Field(min_length=1), BeforeValidator(_point_or_points)]
PositiveTriples = Annotated[list[PositiveTriple], Field(min_length=1), BeforeValidator(_point_or_points)]
UnitQuaternions = Annotated[list[UnitQuaternion], Field(min_length=1), BeforeValidator(_point_or_points)]
ONE_OR_MANY = BeforeValidator(_one_or_many)  # [table] or [[table]]
IN_PLACE_OF_LISTS = (one_number_or_many, _point_or_points, _one_or_many)  # validators that accept a single value


def group_size(section: Any, *names: str) -> int:
    """Number of members of a group, whose fields each have one value for all members, or one for each."""
    sizes = {name: len(value) for name in names if (value := getattr(section, name)) is not None}
    n = max(sizes.values())
    if odd := [f"{name} has {k}" for name, k in sizes.items() if k not in (1, n)]:
        longest = max(sizes, key=lambda name: sizes[name])
        raise problem(
            f"{', '.join(odd)} values and {longest} has {n}", expected="one value for all members, or one for each"
        )
    return n


def member_values(values: np.ndarray, n: int) -> np.ndarray:
    """Values of n members along the first axis; without this axis if n is 1."""
    return values[0] if n == 1 else np.broadcast_to(values, (n, *values.shape[1:]))
