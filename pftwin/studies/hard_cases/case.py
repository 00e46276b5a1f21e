"""What a hard case is: its numbers, why it is hard, and what may and must come out of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pftwin.dynamics.status import Status
from pftwin.studies.hard_cases.contacts import CONTACTS
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
