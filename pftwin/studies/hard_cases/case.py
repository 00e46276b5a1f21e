"""Hard cases, the integrators that run them, and the stated limits of each kind of contact (page.md)."""

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
# Flags by which a simulation refuses its own result.
UNKNOWN = Status.NOT_FINITE | Status.STEP_TOO_LONG | Status.SEARCH_OVERFLOW | Status.ENERGY_FROM_NOWHERE


@dataclass(frozen=True)
class Expected:
    """The expected outcome, beside what holds for every case (see `pftwin.studies.hard_cases.invariants`).

    Geometric flags are not listed: those of no contact and of deep indentation must appear where an
    exhaustive search for the nearest point finds them, and nowhere else.
    """

    must: Status = Status.OK  # flags that some frame must have
    may: Status = Status.OK  # flags that frames may have
    smooth: bool = False  # whether derivatives have to agree with finite differences
    symmetric: bool = False  # about the femur's plane y = 0
    still: bool = False  # nothing moves
    force_at_end: bool | None = None  # whether the button is loaded at the last frame; None: either
    same_as: str | None = None  # the case whose motion this one has to have
    refusal: str | None = None  # words of the `InputError` that has to come instead of a scene


@dataclass(frozen=True)
class HardCase:
    """A scene that is hard to simulate: its numbers are the builder's, and its contact is of any of some kinds."""

    name: str
    topic: str
    about: str  # what is hard, and what is expected, in a sentence or two
    builder: Callable[[], KneeNumbers | RigNumbers]
    expected: Expected = Expected()
    step: float = 1e-3  # [s]
    released: bool = False  # released at rest from the scene's start pose, not from its equilibrium
    contacts: tuple[str, ...] = CONTACTS  # kinds of contact that it exists for
    group: str = "short"  # cases of one group have motions of one length and meshes of one structure
    no_equilibrium: Mapping[str, Sequence[str]] = field(default_factory=dict)  # by contact, float types in which
    limit: str | None = None  # why it is refused there
    unmended: str | None = None  # known failures, and their reasons


class CaseIntegrator(NamedTuple):
    """An integrator, and how it is used here."""

    name: str  # as `pftwin.dynamics.integrators` has it, or another one for `of`
    of: str | None = None  # the integrator's name there
    chooses_steps: bool = False  # whether it takes shorter steps where `pftwin.simulate` does without a step given
    longest_step: float = 1.0  # in the matrix [s]
    most_steps: int | None = None  # of a run: cases that need more are left out; None: no limit
    may_refuse: bool = False  # whether it may flag a step as too long where the case does not expect it
    inertia: bool = True  # without it energy is the stored one alone, and the end of a branch is flagged
    only: tuple[str, ...] | None = None  # kinds of contact that it runs with; None: all
    float32: bool = True
    differentiated_on: tuple[str, ...] | None = None  # kinds of contact with which derivatives are checked; None: all
    side_by_side: bool = True  # whether its batches are checked too

    @property
    def integrator(self) -> Integrator:
        """The integrator itself; InputError where there is none of that name."""
        return integrator_from_text(self.of or self.name)


QUICK = (*PATCHES, "volume")  # derivatives on contours take tens of minutes but for the linearly implicit steps

INTEGRATORS = (
    CaseIntegrator("simulate", of="linear_implicit_bdf2", chooses_steps=True, may_refuse=True, side_by_side=False),
    CaseIntegrator("linear_implicit"),
    CaseIntegrator("linear_implicit_bdf2", may_refuse=True),  # not damped enough for impacts shorter than a step
    # A batch of it compiles for minutes.
    CaseIntegrator("newmark", may_refuse=True, side_by_side=False, differentiated_on=QUICK),
    CaseIntegrator("symplectic_euler", longest_step=1e-4, may_refuse=True, differentiated_on=QUICK),
    # Explicit: it gives up where it would take more than 4,096 steps of its own within one, and says so.
    CaseIntegrator("diffrax:Tsit5", most_steps=1000, may_refuse=True, only=("P5",), float32=False, side_by_side=False),
    # Its derivatives by volume take more than 40 minutes, most of it compiling.
    CaseIntegrator("quasi_static", may_refuse=True, inertia=False, side_by_side=False, differentiated_on=PATCHES),
    # Some 0.3 ms a step, and so few steps; undamped, as Newmark's method.
    CaseIntegrator(
        "ali3p", most_steps=1000, may_refuse=True, only=("P5",), float32=False, differentiated_on=(), side_by_side=False
    ),
)


def method_named(name: str) -> CaseIntegrator:
    """What has that name in `INTEGRATORS`, or any other integrator with its default settings."""
    return next((m for m in INTEGRATORS if m.name == name), CaseIntegrator(name))


class KnownRefusal(NamedTuple):
    """Flags by which runs on a kind of contact may refuse their own result."""

    flags: Status = Status.OK
    at_rim: Status = Status.OK  # once a contact reaches over the rim of an open mesh, which is flagged too
    without_inertia: str | None = None  # words of the error for integrators without inertia


LIMITS = {
    "contours": KnownRefusal(
        Status.ENERGY_FROM_NOWHERE, Status.START_NOT_IN_EQUILIBRIUM, "forces that jump from triangle to triangle"
    ),
    "volume": KnownRefusal(at_rim=Status.START_NOT_IN_EQUILIBRIUM | Status.ENERGY_FROM_NOWHERE),
}


def limit_of(contact: str) -> KnownRefusal:
    """Flags by which runs on a kind of contact may refuse their own result."""
    return LIMITS.get(contact, KnownRefusal())
