"""Base classes of the tables of effects, and tables generated from an effect's declared fields."""

# ruff: noqa: N815  (units in names are written as units are: N, Hz)
from __future__ import annotations

import dataclasses
import re
from abc import abstractmethod
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field, create_model

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.base.leaves import number, vector
from pftwin.base.quantities import Quantity, declared_field
from pftwin.files.scene_file.bones import BonePoses
from pftwin.files.scene_file.document import Document, Place
from pftwin.files.scene_file.section import (
    Name,
    NotNegative,
    Point,
    Points,
    Section,
    group_size,
    member_values,
    one_number_or_many,
)
from pftwin.files.scene_file.side import HostPose, Side
from pftwin.files.scene_file.wrap_table import WRAP, Wrap, obstacle
from pftwin.model.effects.base import Effect
from pftwin.model.effects.damping import LinearDamping
from pftwin.model.effects.gravity import Gravity

if TYPE_CHECKING:
    from pftwin.geometry.mesh.mesh import SurfaceMesh
    from pftwin.geometry.patch.sphere import SphereFit


@dataclass(frozen=True)
class Setting:
    """Context from which a table builds an effect or a part of one."""

    bones: BonePoses
    mass: float  # of the patella [kg]
    start: HostPose  # pose of the patella in the femur's frame at the first frame
    contact: str | None = None  # polynomial requested on the command line, instead of the file's
    buttons: dict[str, SphereFit] = field(default_factory=dict)  # fitted spheres by contact, patella frame
    notes: list[str] = field(default_factory=list)  # for the user
    place: Place = ()

    @property
    def side(self) -> Side:
        """Transformation from the file's axes to those of a right knee."""
        return self.bones.side

    @property
    def document(self) -> Document:
        """The file."""
        return self.bones.recording.document

    def at(self, *steps: str | int) -> Setting:
        """The setting of a nested table."""
        return replace(self, place=(*self.place, *steps))

    def where(self, *steps: str) -> str:
        """File, line and field, for a field of this table or the table itself."""
        return self.document.where(*self.place, *steps)

    def naming(self, *steps: str) -> AbstractContextManager[None]:
        """Context manager that prefixes messages of InputErrors with this location."""
        return self.document.naming(*self.place, *steps)

    def path(self, name: str) -> str:
        """Path of a file; relative paths start at the scene file. Raises InputError as `Document.file`."""
        return str(self.document.file(name))

    def sphere(self, mesh: SurfaceMesh, label: str, tolerance: float | None = None) -> tuple[Floats, float]:
        """Centre (3,) in the patella's frame and radius of a sphere fitted to a button's mesh [m].

        The mesh is in the patella's axes of the file. The fit is stored under the contact's label, and a note reports
        its quality; `tolerance` limits the deviation [m].
        """
        from pftwin.geometry.patch.sphere import fit_sphere

        with self.naming("mesh"):
            found = fit_sphere(mesh, **({} if tolerance is None else {"tolerance": tolerance}))
        self.notes.append(f"{mesh.source}: {found}")
        center, axis = (self.points("patella", p) for p in (found.center, found.axis))
        self.buttons[label] = replace(found, center=center, axis=axis)
        return center, float(found.radius)

    def points(self, frame: str, values: ArrayLike) -> Floats:
        """Transforms points (..., 3) of a body's frame to the scene's; mirrored for a left knee."""
        mirrored = self.side.points(frame, values)
        if frame == "ground" and self.bones.fixed_femur is not None:
            return self.bones.fixed_femur.inverse().apply(mirrored)
        return mirrored

    def world_direction(self, values: ArrayLike) -> Floats:
        """Transforms a direction from the file's world to the scene's."""
        mirrored = self.side.points("world", values)
        return mirrored if self.bones.fixed_femur is None else mirrored @ self.bones.fixed_femur.matrix


Body = Literal["femur", "tibia", "ground"]


class EffectSection(Section):
    """A table that builds an effect. `kind` is the table's name, and the default name of the effect."""

    kind: ClassVar[str]
    name: Name | None = Field(default=None, description="name of the effect in results; the table's name by default")

    @property
    def label(self) -> str:
        """The effect's name."""
        return self.name or self.kind

    @abstractmethod
    def build(self, setting: Setting) -> Effect:
        """The effect. Raises InputError for files that cannot be used, and for groups of different lengths."""


class GravitySection(EffectSection):
    """The patella's weight."""

    kind: ClassVar[str] = "gravity"
    acceleration_m_per_s2: Point = Field(description="acceleration of gravity in the world [m/s^2]")

    def build(self, setting: Setting) -> Gravity:
        """The effect."""
        acceleration = setting.world_direction(self.acceleration_m_per_s2)
        return Gravity(number(setting.mass), vector(acceleration), name=self.label)


class DampingSection(EffectSection):
    """Linear viscous damping of the patella's motion."""

    kind: ClassVar[str] = "damping"
    translational_N_s_per_m: NotNegative = Field(description="damping of translation [N s/m]")
    rotational_N_m_s_per_rad: NotNegative = Field(description="damping of rotation [N m s/rad]")
    body: Body = Field(default="femur", description="body relative to which the motion is damped")

    def build(self, setting: Setting) -> LinearDamping:
        """The effect."""
        rates = number(self.translational_N_s_per_m), number(self.rotational_N_m_s_per_rad)
        return LinearDamping(*rates, body=self.body, name=self.label)


class FieldMapping(NamedTuple):
    """Mapping from a table's fields to those of an effect."""

    effect: Callable[..., Effect]
    numbers: dict[str, str]  # fields of numbers, and the effect's names
    points: dict[str, tuple[str, str]]  # fields of points, and the effect's names and frames
    unchanged: list[str]  # fields that are passed unchanged
    obstacles: list[str]  # tables of wrapping obstacles


class DeclaredSection(EffectSection):
    """A table whose fields are generated from an effect's declarations: see `declared_table`."""

    _mapping: ClassVar[FieldMapping]

    def _check(self) -> None:
        group_size(self, *self._mapping.numbers, *self._mapping.points)

    def build(self, setting: Setting) -> Effect:
        """The effect, or a group of them."""
        effect, numbers, points, unchanged, obstacles = self._mapping
        n = group_size(self, *numbers, *points)
        values: dict[str, Any] = {name: getattr(self, name) for name in unchanged}
        for label, name in numbers.items():
            values[name] = number(member_values(np.asarray(getattr(self, label), dtype=float), n))
        for label, (name, frame) in points.items():
            written = getattr(self, label)
            body = values["body"] if frame == "body" else frame
            placed = setting.world_direction(written) if body == "world" else setting.points(body, written)
            values[name] = vector(member_values(placed, n))
        for name in obstacles:
            values[name] = obstacle(getattr(self, name), n, setting)
        return effect(**values, name=self.label)


_STATIC_TYPES = {"bool": bool, "int": int, "float": float, "str": str}  # types of fields that are not parameters


def declared_table(
    effect: type[Effect],
    kind: str | None = None,
    *,
    words: Mapping[str, str] | None = None,
    defaults: Mapping[str, float] | None = None,
) -> type[DeclaredSection]:
    """Generates the table for a class of effects.

    Every parameter becomes a field named with its unit (`stiffness_N_per_m`), with its declared bounds; single values
    make a single effect, lists make a group. Vectors are points of their declared frame. Static fields that are
    numbers, strings or booleans are read unchanged, `body` as one of the bodies; an `Obstacle` is a table.

    Args:
        effect: the class.
        kind: name of the table; by default the class's, in lower case with underscores.
        words: descriptions of fields, by the effect's names.
        defaults: default values of numbers, by the effect's names, in addition to the class's defaults.

    Raises:
        InputError: a field of another kind, or a point whose frame is not declared.
    """
    kind = kind or re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", effect.__name__).lower()
    words, fields, mapping = words or {}, {}, FieldMapping(effect, {}, {}, [], [])
    for f in dataclasses.fields(effect):
        if f.name == "name":
            continue
        if "Obstacle" in str(f.type):
            fields[f.name] = Wrap, WRAP
            mapping.obstacles.append(f.name)
            continue
        declared = declared_field(effect, f.name)
        default: Any = {} if f.default is dataclasses.MISSING else {"default": f.default}
        if declared is None:
            fields[f.name] = _static(effect, f.name, f.type, default)
            mapping.unchanged.append(f.name)
            continue
        suffix = declared.unit.replace("/", "_per_").replace(" ", "_").replace("^", "")  # N_s_per_m
        label = f"{f.name}_{suffix}" if suffix else f.name
        described = words.get(f.name, f.name)
        if "Vec3" in str(f.type):
            if not declared.frame:
                raise _unreadable(effect, f.name, 'quantity(..., frame="patella"), "body", "femur", "tibia", "world"')
            mapping.points[label] = f.name, declared.frame
            described = described if f.name in words else f"{f.name} [{declared.unit}], frame: {declared.frame}"
            fields[label] = Points, Field(description=described, **default)
        else:
            mapping.numbers[label] = f.name
            default = default or ({"default": (defaults or {})[f.name]} if f.name in (defaults or {}) else {})
            default = {k: [float(v)] for k, v in default.items()}
            fields[label] = _values(declared), Field(description=f"{described} [{declared.unit or '-'}]", **default)
    doc = (effect.__doc__ or kind).splitlines()[0]
    made = create_model(f"{effect.__name__}Section", __base__=DeclaredSection, __doc__=doc, **fields)
    made.kind, made._mapping = kind, mapping
    return made


def _values(declared: Quantity) -> Any:
    """Type of a number within bounds or a list of these."""
    above = 0.0 if declared.positive else None
    least = declared.lower if not declared.positive and declared.lower > -np.inf else None
    one = Annotated[float, Field(gt=above, ge=least, le=declared.upper if declared.upper < np.inf else None)]
    return Annotated[list[one], Field(min_length=1), BeforeValidator(one_number_or_many)]


def _static(effect: type[Effect], name: str, kind: Any, default: dict[str, Any]) -> Any:
    """Type and `Field` for a static field of the effect."""
    if name == "body":
        return Body, Field(description="body at the other end", **default)
    static_type = _STATIC_TYPES.get(getattr(kind, "__name__", str(kind)))
    if static_type is None:
        raise _unreadable(effect, name, "quantity(unit), or a static bool, int, float or str")
    return static_type, Field(description=name.replace("_", " "), **default)


def _unreadable(effect: type[Effect], name: str, expected: str) -> InputError:
    return InputError(
        f"no table of a scene file follows from {effect.__name__}",
        where=f"{effect.__name__}.{name}",
        expected=f"a field that declares {expected}",
        remedy="or register a table of your own, derived from EffectSection",
    )
