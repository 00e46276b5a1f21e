"""What a hard case is: its numbers, why it is hard, and what may and must come out of it.

The integrators that all cases run with. A new one is a line in `INTEGRATORS`.

Where a kind of contact has no answer to any case that goes so far, whatever the integrator. page.md says why.

A run on it that says so itself is refused, not failed: as long as everything was right until then.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from pftwin.dynamics.status import Status
from pftwin.studies.hard_cases.contacts import CONTACTS, PATCHES
from pftwin.studies.hard_cases.knee import KneeNumbers

NOTHING = Status.OK
RELEASED = Status.START_NOT_IN_EQUILIBRIUM
UNKNOWN = (  # what a simulation may refuse itself with
    Status.NOT_FINITE | Status.STEP_TOO_LONG | Status.SEARCH_OVERFLOW | Status.ENERGY_FROM_NOWHERE
)


@dataclass(frozen=True)
class Expected:
    """What has to come out, beside what holds of every case (see `pftwin.studies.hard_cases.invariants`).

    Flags of geometry are not listed: those of no contact and of deep indentation have to be there where an
    exhaustive search for the nearest point says so, and nowhere else.
    """

    must: Status = NOTHING  # flags that some frame has
    may: Status = NOTHING  # flags that frames may have
    smooth: bool = False  # whether derivatives have to agree with finite differences
    symmetric: bool = False  # about the femur's plane y = 0
    still: bool = False  # nothing moves
    force_at_end: bool | None = None  # whether the button is loaded at the last frame; None: either
    same_as: str | None = None  # the case whose motion this one has to have
    refusal: str | None = None  # words of the `InputError` that has to come instead of a scene


@dataclass(frozen=True)
class HardCase:
    """A scene that is hard to simulate.

    `builder` makes its numbers; the scene follows from them and a kind of contact.
    """

    name: str
    topic: str
    about: str  # what is hard, and what is expected, in a sentence or two
    builder: Callable[[], KneeNumbers]
    expected: Expected = Expected()
    step: float = 1e-3  # [s]
    released: bool = False  # starts where it is put, at rest, and not in its equilibrium
    contacts: tuple[str, ...] = CONTACTS  # that it can be had with
    group: str = "short"  # cases of one group have motions of one length and meshes of one structure
    unmended: str | None = None  # where it fails, and what is known of that


class CaseIntegrator(NamedTuple):
    """An integrator, and how it is used here."""

    name: str  # as `pftwin.dynamics.integrators` has it
    longest_step: float = 1.0  # that the matrix gives it [s]
    most_steps: int | None = None  # of a run: cases that need more are left out; None: no limit
    may_refuse: bool = False  # whether it may say that a step is too long for a case, where the case does not
    inertia: bool = True  # without: energy is the stored one alone, and equilibria that end are told by a flag
    only: tuple[str, ...] | None = None  # kinds of contact that it runs with; None: all
    float32: bool = True
    differentiated_on: tuple[str, ...] | None = None  # kinds of contact with which derivatives are looked at; None: all
    side_by_side: bool = True  # whether batches of it are looked at too


QUICK = (*PATCHES, "volume")  # derivatives on contours take tens of minutes but for the linearly implicit steps

INTEGRATORS = (
    CaseIntegrator("linear_implicit"),
    CaseIntegrator("linear_implicit_bdf2", may_refuse=True),  # not damped enough for impacts shorter than a step
    CaseIntegrator(
        "newmark", may_refuse=True, side_by_side=False, differentiated_on=QUICK
    ),  # a batch compiles for minutes
    CaseIntegrator("symplectic_euler", longest_step=1e-4, may_refuse=True, differentiated_on=QUICK),
    CaseIntegrator("diffrax:Tsit5", may_refuse=True, only=("P5",), float32=False),
    # By volume its derivatives were not there after 40 minutes, most of it compiling.
    CaseIntegrator("quasi_static", may_refuse=True, inertia=False, side_by_side=False, differentiated_on=PATCHES),
    # Some 0.3 ms a step, and so few steps; undamped, as Newmark's method.
    CaseIntegrator(
        "ali3p",
        most_steps=1000,
        may_refuse=True,
        only=("P5",),
        float32=False,
        differentiated_on=(),
        side_by_side=False,
    ),
)


def method_named(name: str) -> CaseIntegrator:
    """That of `INTEGRATORS`, or any other integrator as it comes."""
    return next((m for m in INTEGRATORS if m.name == name), CaseIntegrator(name))


class KnownRefusal(NamedTuple):
    """What runs on a kind of contact may refuse themselves with."""

    flags: Status = Status.OK
    at_rim: Status = Status.OK  # and where they have said by then that a contact reaches over the rim of an open mesh
    without_inertia: str | None = None  # words with which integrators without inertia are refused


_NONE = KnownRefusal()
LIMITS = {
    "contours": KnownRefusal(
        Status.ENERGY_FROM_NOWHERE, Status.START_NOT_IN_EQUILIBRIUM, "forces that jump from triangle to triangle"
    ),
    "volume": KnownRefusal(at_rim=Status.START_NOT_IN_EQUILIBRIUM | Status.ENERGY_FROM_NOWHERE),
}


def limit_of(contact: str) -> KnownRefusal:
    """That of a kind of contact."""
    return LIMITS.get(contact, _NONE)
