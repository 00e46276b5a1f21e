"""Definitions of hard cases, the integrators that run them, and the known limits of each kind of contact (page.md)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from pftwin.dynamics.integrator import Integrator
from pftwin.dynamics.integrators import integrator_from_text
from pftwin.dynamics.status import Status
from pftwin.studies.hard_cases.contacts import CONTACTS, PATCHES

if TYPE_CHECKING:
    from pftwin.studies.hard_cases.catalogue import RigNumbers
    from pftwin.studies.hard_cases.knee import KneeNumbers

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
    builder: Callable[[], KneeNumbers | RigNumbers]
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

    name: str  # name in `pftwin.dynamics.integrators`, or an alias for `of`
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
