"""Hard cases and their catalogue (cases.toml), the integrators that run them, known limits of contacts (page.md)."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache, reduce
from importlib.resources import files
from typing import Any, Literal, NamedTuple

from pftwin import rig
from pftwin.base.errors import InputError
from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrator_text import integrator_from_text
from pftwin.dynamics.status import Status
from pftwin.geometry.patch.charts import CylindricalChart
from pftwin.model.scene import Scene
from pftwin.rig import geometry
from pftwin.rig.contacts import contact_fit
from pftwin.studies.hard_cases import knee
from pftwin.studies.hard_cases.contacts import CONTACTS, MESHES, PATCHES
from pftwin.studies.hard_cases.ground import CYLINDER, GROUNDS, MESH_MAKERS, PLATE

RELEASED = Status.START_NOT_IN_EQUILIBRIUM
# Flags with which a simulation rejects its own result.
UNKNOWN = Status.NOT_FINITE | Status.STEP_TOO_LONG | Status.SEARCH_OVERFLOW | Status.ENERGY_FROM_NOWHERE


@dataclass(frozen=True)
class Expected:
    """Expected outcome of a case, in addition to the invariants of all cases (`pftwin.studies.hard_cases.invariants`).

    Geometric flags are not listed: no contact and deep indentation must be flagged exactly where an exhaustive
    search for the closest point finds them.
    """

    must: Status = Status.OK  # flags that must occur in some frame
    may: Status = Status.OK  # flags that may occur
    smooth: bool = False  # whether derivatives must agree with finite differences
    symmetric: bool = False  # whether the motion is symmetric about the femur's plane y = 0
    still: bool = False  # whether nothing moves
    force_at_end: bool | None = None  # whether the button is loaded at the last frame; None: either
    same_as: str | None = None  # name of a case that must have the same motion
    refusal: str | None = None  # words of the `InputError` that must be raised instead of building a scene


@dataclass(frozen=True)
class HardCase:
    """A scene that is hard to simulate: parameters from `builder`, with each of several kinds of contact."""

    name: str
    topic: str
    about: str  # difficulty and expected outcome, in a sentence or two
    builder: Callable[[], knee.KneeNumbers | RigNumbers]
    expected: Expected = Expected()
    step: float = 1e-3  # time step [s]
    released: bool = False  # whether it is released at rest from the scene's start pose, not from equilibrium
    contacts: tuple[str, ...] = CONTACTS  # kinds of contact to run
    group: str = "short"  # cases of one group have motions of equal length and meshes of equal structure
    no_equilibrium: Mapping[str, Sequence[str]] = field(default_factory=dict)  # by contact: float types without one
    limit: str | None = None  # reason for that
    unmended: str | None = None  # known failures and their reasons


class CaseIntegrator(NamedTuple):
    """An integrator and its settings in the matrix."""

    name: str  # name in `pftwin.dynamics.integrator_text`, or an alias for `of`
    of: str | None = None  # name of the integrator if `name` is an alias
    chooses_steps: bool = False  # whether it shortens steps as `pftwin.simulate` does if no step is given
    longest_step: float = 1.0  # longest step in the matrix [s]
    most_steps: int | None = None  # per run: cases that need more are omitted; None: no limit
    may_refuse: bool = False  # whether it may flag a step as too long if the case does not expect it
    inertia: bool = True  # without inertia, the energy is only the stored one, and the end of a branch is flagged
    only: tuple[str, ...] | None = None  # kinds of contact to run; None: all
    float32: bool = True  # whether it also runs in float32
    differentiated_on: tuple[str, ...] | None = None  # kinds of contact for which derivatives are checked; None: all
    side_by_side: bool = True  # whether runs in one batch (`jax.vmap`) are also checked

    @property
    def integrator(self) -> Integrator:
        """The integrator; InputError for an unknown name."""
        return integrator_from_text(self.of or self.name)


QUICK = (*PATCHES, "volume")  # contours take tens of minutes to differentiate, except with linearly implicit steps

INTEGRATORS = (
    CaseIntegrator("simulate", of="linear_implicit_bdf2", chooses_steps=True, may_refuse=True, side_by_side=False),
    CaseIntegrator("linear_implicit"),
    CaseIntegrator("linear_implicit_bdf2", may_refuse=True),  # not damped enough for impacts shorter than a step
    # A batch takes minutes to compile.
    CaseIntegrator("newmark", may_refuse=True, side_by_side=False, differentiated_on=QUICK),
    CaseIntegrator("symplectic_euler", longest_step=1e-4, may_refuse=True, differentiated_on=QUICK),
    # Explicit: it stops, and flags this, if one step needs more than 4,096 internal steps.
    CaseIntegrator("diffrax:Tsit5", most_steps=1000, may_refuse=True, only=("P5",), float32=False, side_by_side=False),
    # Derivatives with "volume" take more than 40 minutes, mostly to compile.
    CaseIntegrator("quasi_static", may_refuse=True, inertia=False, side_by_side=False, differentiated_on=PATCHES),
    # About 0.3 ms per step, hence the limit of steps; without numerical damping, as Newmark's method.
    CaseIntegrator(
        "ali3p", most_steps=1000, may_refuse=True, only=("P5",), float32=False, differentiated_on=(), side_by_side=False
    ),
)


def method_named(name: str) -> CaseIntegrator:
    """Returns the entry of `INTEGRATORS` with that name, or else any other integrator with default settings."""
    return next((m for m in INTEGRATORS if m.name == name), CaseIntegrator(name))


class KnownRefusal(NamedTuple):
    """Flags with which runs on a kind of contact may reject their own result."""

    flags: Status = Status.OK  # allowed in all runs
    at_rim: Status = Status.OK  # allowed after a contact crosses the rim of an open mesh, which is flagged too
    without_inertia: str | None = None  # words of the error for integrators without inertia


LIMITS = {
    "contours": KnownRefusal(
        Status.ENERGY_FROM_NOWHERE, Status.START_NOT_IN_EQUILIBRIUM, "forces that jump from triangle to triangle"
    ),
    "volume": KnownRefusal(at_rim=Status.START_NOT_IN_EQUILIBRIUM | Status.ENERGY_FROM_NOWHERE),
}


def limit_of(contact: str) -> KnownRefusal:
    """Returns the known limits of a kind of contact."""
    return LIMITS.get(contact, KnownRefusal())


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
