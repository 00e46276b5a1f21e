"""The table of an effect that follows from what its fields declare: one field for each, with the unit in its name."""

from __future__ import annotations

import dataclasses
import re
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import BeforeValidator, Field, create_model, model_validator

from pftwin.base.errors import InputError
from pftwin.base.leaves import number, vector
from pftwin.base.quantities import Quantity, declared_field
from pftwin.files.scene_file.effect_tables import Body, EffectSection, Setting
from pftwin.files.scene_file.section import Points, one_number_or_many
from pftwin.files.scene_file.tendon_table import group_size, member_values
from pftwin.model.effects.base import Effect

_PLAIN = {"bool": bool, "int": int, "float": float, "str": str}  # what a field that is no parameter may be


def declared_table(effect: type[Effect], kind: str | None = None) -> type[EffectSection]:
    """A table for a class of effects.

    Every parameter becomes a field named with its unit (`stiffness_N_per_m`), with its declared bounds; one value makes
    a single effect, lists make a group. Vectors are points of the frame that they declare. Static fields that are
    numbers, words or truth values are read as they are, `body` as one of the bodies.

    Raises:
        InputError: a field that is neither, or a point whose frame is not declared.
    """
    kind = kind or re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", effect.__name__).lower()
    fields: dict[str, Any] = {}
    numbers: dict[str, str] = {}
    points: dict[str, tuple[str, str]] = {}
    for f in dataclasses.fields(effect):
        if f.name == "name":
            continue
        declared = declared_field(effect, f.name)
        default: Any = {} if f.default is dataclasses.MISSING else {"default": f.default}
        if declared is None:
            fields[f.name] = _static(effect, f.name, f.type, default)
        elif "Vec3" in str(f.type):
            if not declared.frame:
                raise _unreadable(effect, f.name, 'quantity(..., frame="patella"), "body", "femur", "tibia", "world"')
            label = f"{f.name}_{_suffix(declared.unit)}"
            points[label] = f.name, declared.frame
            fields[label] = Points, Field(description=f"{f.name} [{declared.unit}], frame: {declared.frame}", **default)
        else:
            label = "_".join(part for part in (f.name, _suffix(declared.unit)) if part)
            numbers[label] = f.name
            default = {k: [float(v)] for k, v in default.items()}
            fields[label] = _values(declared), Field(description=f"{f.name} [{declared.unit or '-'}]", **default)

    base = _table_class(effect, kind, numbers, points, [n for n in fields if n not in numbers and n not in points])
    doc = (effect.__doc__ or kind).splitlines()[0]
    return create_model(f"{effect.__name__}Section", __base__=base, __doc__=doc, __module__=__name__, **fields)


def _table_class(
    effect: type[Effect],
    kind_of_table: str,
    numbers: dict[str, str],
    points: dict[str, tuple[str, str]],
    plain: list[str],
) -> type[EffectSection]:
    """The table without its fields: how its values become the effect."""

    class DeclaredSection(EffectSection):
        kind: ClassVar[str] = kind_of_table

        @model_validator(mode="after")
        def _consistent(self) -> Self:
            group_size(self, *numbers, *points)
            return self

        def build(self, setting: Setting, at: tuple[str | int, ...]) -> Effect:
            """The effect."""
            n = group_size(self, *numbers, *points)
            values: dict[str, Any] = {name: getattr(self, name) for name in plain}
            for label, name in numbers.items():
                values[name] = number(member_values(np.asarray(getattr(self, label), dtype=float), n))
            for label, (name, frame) in points.items():
                written = getattr(self, label)
                body = values["body"] if frame == "body" else frame
                placed = setting.world_direction(written) if body == "world" else setting.points(body, written)
                values[name] = vector(member_values(placed, n))
            return effect(**values, name=self.label)

    return DeclaredSection


def _values(declared: Quantity) -> Any:
    """The type of a list of numbers within bounds, or a single one."""
    above = 0.0 if declared.positive else None
    least = declared.lower if not declared.positive and declared.lower > -np.inf else None
    one = Annotated[float, Field(gt=above, ge=least, le=declared.upper if declared.upper < np.inf else None)]
    return Annotated[list[one], Field(min_length=1), BeforeValidator(one_number_or_many)]


def _static(effect: type[Effect], name: str, kind: Any, default: dict[str, Any]) -> Any:
    """Type and field of what is no parameter."""
    if name == "body":
        return Body, Field(description="body at the other end", **default)
    plain = _PLAIN.get(getattr(kind, "__name__", str(kind)))
    if plain is None:
        raise _unreadable(effect, name, "quantity(unit), or a static bool, int, float or str")
    return plain, Field(description=name.replace("_", " "), **default)


def _suffix(unit: str) -> str:
    """A unit as field names have it: N_s_per_m."""
    return unit.replace("/", "_per_").replace(" ", "_").replace("^", "")


def _unreadable(effect: type[Effect], name: str, expected: str) -> InputError:
    return InputError(
        f"no table of a scene file follows from {effect.__name__}",
        where=f"{effect.__name__}.{name}",
        expected=f"a field that declares {expected}",
        remedy="or register a table of your own, derived from EffectSection",
    )
