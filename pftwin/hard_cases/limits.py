"""Where a kind of contact has no answer to any case that goes so far, whatever the integrator: flags, and why.

A run on it that says so itself is refused, not failed: as long as everything was right until then.
"""

from __future__ import annotations

from typing import NamedTuple

from pftwin.dynamics.observe import Status


class Limit(NamedTuple):
    """What runs on a kind of contact may refuse themselves with."""

    flags: Status
    at_rim: Status  # what such a run may bear besides, where it says that a contact reaches over a rim
    why: str


_NONE = Limit(Status.OK, Status.OK, "")
LIMITS = {
    "contours": Limit(
        Status.ENERGY_FROM_NOWHERE,
        Status.START_NOT_IN_EQUILIBRIUM,
        "The force of contours of contact (Michaud et al. 2024) is that of the deepest corner's indentation, at the"
        " contour's middle, along its area vector. It is no potential's gradient: turned about its own middle, a button"
        " of triangles stores more and less as its corners come and go, and nobody does work; and on the rim of an open"
        " mesh a contour is not closed, and there need be no equilibrium. So rolling over corners creates energy, or"
        " takes it. That is a matter of the meshes and not of the step: in tendon_stiff 14 % of the largest energy is"
        " created by a button of 1,280 triangles on a ground of 24 with steps of 1 ms, and 46 % with an eighth of that;"
        " by 5,120 on 384 0.28 % with both; by 20,480 on 1,536 0.15 and 0.04 %. The cases' meshes are that coarse on"
        " purpose.",
    )
}


def limit_of(contact: str) -> Limit:
    """That of a kind of contact."""
    return LIMITS.get(contact, _NONE)
