"""Where a kind of contact has no answer to any case that goes so far, whatever the integrator. page.md says why.

A run on it that says so itself is refused, not failed: as long as everything was right until then.
"""

from __future__ import annotations

from typing import NamedTuple

from pftwin.dynamics.status import Status


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
