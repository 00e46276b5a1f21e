"""The catalogue of hard cases, read from cases.toml: cases of the small knee and of the virtual rig."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache, reduce
from importlib.resources import files
from typing import Any, Literal

from pftwin import rig
from pftwin.base.errors import InputError
from pftwin.dynamics.status import Status
from pftwin.geometry.patch.charts import CylindricalChart
from pftwin.model.scene import Scene
from pftwin.rig import geometry
from pftwin.rig.contacts import contact_fit
from pftwin.studies.hard_cases import knee
from pftwin.studies.hard_cases.case import RELEASED, Expected, HardCase
from pftwin.studies.hard_cases.contacts import CONTACTS, MESHES, PATCHES
from pftwin.studies.hard_cases.ground import CYLINDER, GROUNDS, MESH_MAKERS, PLATE

STIFFNESS = "contact.law.contact_stiffness"


@dataclass(frozen=True)
class RigNumbers:
    """A case of the rig, with the same interface as `pftwin.studies.hard_cases.knee.KneeNumbers`."""

    case: int
    factors: Mapping[str, float] = field(default_factory=dict)  # factors on parameters, by name

    @property
    def law(self) -> knee.Law:
        """Parameters of the contact law."""
        return knee.Law(geometry.CONTACT_STIFFNESS * self.factors.get(STIFFNESS, 1.0), restitution=geometry.RESTITUTION)

    @property
    def radius(self) -> float:
        """Radius of the button [m]."""
        return geometry.BUTTON_RADIUS

    def scene_on(self, kind: str, name: str) -> Scene:
        """See `KneeNumbers`."""
        patch, chart = _parts(kind)
        scene = rig.case(self.case, contact=patch, chart=chart)
        for number, factor in self.factors.items():
            scene = scene.set(number, scene.get(number) * factor)
        return replace(scene, name=name)

    def axis_below(self, kind: str) -> float:
        """See `KneeNumbers`."""
        patch, shape = _parts(kind)
        chart = contact_fit(patch, chart=shape).patch.chart
        return float(chart.radius) if isinstance(chart, CylindricalChart) else 0.0


def _parts(kind: str) -> tuple[str, Literal["plane", "cylinder"]]:
    """The name and the chart of a patch."""
    return kind.removesuffix(CYLINDER), "cylinder" if kind.endswith(CYLINDER) else "plane"


_ABSENT = knee.TendonNumbers(156, 10.0, (0.02, 0, -0.008), (0.22, 0, 0.035))  # always slack
_ORIGIN = (0.0, 0.0, 0.0)
FREE = knee.KneeNumbers(
    ground=PLATE, center_of_mass=_ORIGIN, quadriceps=_ABSENT, patellar_tendon=_ABSENT, tibia=knee.standing,
    start=(0.0, 0.0, knee.RADIUS),
)  # fmt: skip
KNEES = {
    "plain": knee.KneeNumbers(),
    "free": FREE,
    "level": replace(
        FREE,
        quadriceps=knee.TendonNumbers(156, 0.06, (0.02, 0, -0.008), (0.1, 0.0, knee.RADIUS - 0.02)),
        patellar_tendon=knee.TendonNumbers(156, 0.06, (-0.02, 0, -0.008), (-0.1, 0.0, knee.RADIUS - 0.02)),
    ),
    # Lands on a triangle: on a corner the button would balance, and rounding would decide to which side it falls.
    "on_mesh": replace(FREE, ground=GROUNDS["floor"], start=(0.004, 0.006, knee.RADIUS + 5e-4), turn=(0.0, 0.087, 0.0)),
}
_NAMED: dict[str, Mapping[str, Any]] = {
    "ground": {**GROUNDS, "trochlea": knee.TROCHLEA}, "tibia": knee.MOTIONS, "mesh": MESH_MAKERS,
}  # fmt: skip
_KINDS = {"patches": PATCHES, "meshes": MESHES}


@cache
def catalogue() -> tuple[HardCase, ...]:
    """Returns all cases, by topic."""
    topics = tomllib.loads(files("pftwin.studies.hard_cases").joinpath("cases.toml").read_text(encoding="utf-8"))
    texts = topics.pop("texts")
    return tuple(_case(topic, entry, texts) for topic, entries in topics.items() for entry in entries)


def case_named(name: str) -> HardCase:
    """Returns the case of that name; InputError if there is none."""
    for case in catalogue():
        if case.name == name:
            return case
    raise InputError(f"no case {name!r}", where="hard cases", expected="a name that pftwin hard-cases --list shows")


def _case(topic: str, entry: dict[str, Any], texts: dict[str, str]) -> HardCase:
    flags = {key: reduce(Status.__or__, (Status[n] for n in entry.get(key, ())), Status.OK) for key in ("must", "may")}
    if entry.get("released"):
        flags["may"] |= RELEASED
    expected = Expected(
        **flags,
        **dict.fromkeys(entry.get("holds", ()), True),
        **{f.name: entry[f.name] for f in fields(Expected) if f.name in entry and f.name not in flags},
    )
    kinds = [k for name in entry.get("contacts", CONTACTS) for k in _KINDS.get(name, (name,))]
    own = {f.name: entry[f.name] for f in fields(HardCase) if f.name in entry and f.name != "contacts"}
    own |= {key: own[key] if " " in own[key] else texts[own[key]] for key in ("limit", "unmended") if key in own}
    return HardCase(topic=topic, builder=lambda: _knee(entry), expected=expected, contacts=tuple(kinds), **own)


def _knee(entry: dict[str, Any]) -> knee.KneeNumbers | RigNumbers:
    if "rig" in entry:
        return RigNumbers(entry["rig"], entry.get("factors", {}))
    base = knee.drawn(entry["seed"]) if "seed" in entry else KNEES[entry.get("knee", "plain")]
    return _changed(base, entry.get("change", {}))


def _changed(value: Any, change: dict[str, Any]) -> Any:
    """Returns a dataclass with changed fields; a nested table changes the fields of a nested dataclass."""

    def changed(key: str, new: Any) -> Any:
        if isinstance(new, dict):
            return _changed(getattr(value, key), new)
        if isinstance(new, list):
            return tuple(new)
        return _NAMED[key][new] if key in _NAMED else new

    return replace(value, **{key: changed(key, new) for key, new in change.items()})
