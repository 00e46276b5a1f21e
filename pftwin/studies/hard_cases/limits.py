"""Where a kind of contact has no answer to any case that goes so far, whatever the integrator: flags, and why.

A run on it that says so itself is refused, not failed: as long as everything was right until then.
"""

from __future__ import annotations

from typing import NamedTuple

from pftwin.dynamics.status import Status


class Limit(NamedTuple):
    """What runs on a kind of contact may refuse themselves with."""

    flags: Status
    at_rim: Status  # and where they have said by then that a contact reaches over the rim of an open mesh
    why: str
    without_inertia: str | None = None  # words with which integrators without inertia are refused


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
        " purpose. Without inertia there is no answer at all: forces jump from triangle to triangle, between two of"
        " which nothing balances. On the rig's coarse mesh `quasi_static` in steps of 5 ms took seventy times as long"
        " as the dynamics in steps of 2 ms, left steps unsolved, said so, and was 0.9 mm off; it is refused, in words.",
        "forces that jump from triangle to triangle",
    ),
    "volume": Limit(
        Status.OK,
        Status.START_NOT_IN_EQUILIBRIUM | Status.ENERGY_FROM_NOWHERE,
        "An open mesh ends at its rim, where a patch goes on along its tangent: a sphere that slides over the rim"
        " need not come to rest at all, and can get behind the surface. When its centre does, the indentation of a"
        " sphere on a plane jumps from 0.73 to 1.27 radii, the long way out, and with it what is stored: so deep the"
        " law of a small deformation means nothing, which DEEP_INDENTATION says.",
    ),
}


def limit_of(contact: str) -> Limit:
    """That of a kind of contact."""
    return LIMITS.get(contact, _NONE)
