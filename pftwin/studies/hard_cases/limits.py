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


_AMPLIFIED = (
    "By volume, in float32, the derivatives of undamped steps (Newmark, explicit). Where the button goes from triangle"
    " to triangle the motion multiplies rounding: Newmark's ends 0.002 to 1 mm from float64's, and its derivatives,"
    " which agree to 1e-4 until then, are those of another path. In steps of 10 ms float64 refuses itself."
)

# Cases that fail somewhere, with what is known of it; nothing is excused by standing here.
UNMENDED = {
    "button_of_1_mm": "Over a cylinder, in float32, by explicit steps. The patella comes to rest 40 mm from where it"
    " is put; the search for it moves it by up to 2 mm from one look to the next, and a contact point follows by at"
    " most 0.12 radii, which here is 0.12 mm: it lags behind, and the search swings between free and 1 mm deep until"
    " its count ends. A damped fall then finds the place, on all kinds of contact. Here the last iterate lies behind"
    " the surface, where the point that is followed is not the nearest one. Steps of at most a quarter of the radius"
    " mend that, and let the count run out elsewhere.",
    "button_of_1_m": "By contours: the ball's own triangles are larger than the mesh that it lies on. It comes to"
    " bear on the rim of the open mesh, where contours are not closed, and finds no equilibrium, which every frame"
    " says. A frame later it has rolled over the rim and cuts it without a corner inside: 90 mm deep by the exhaustive"
    " search, and without a force; said is that the contact reaches over the rim, and once no triangles meet, that it"
    " is too deep.",
    "at_random_4": "By contours, whose force jumps from triangle to triangle: the search stops 0.6 N from"
    " balance, from the start and from the end of the damped relaxation. With LLVM's optimisations, which the"
    " matrix does without, rounding is another, and it goes on to 1e-10 N. Every frame says that the run did not"
    " start from an equilibrium.",
    "step_of_50_us": "By contours: the derivative by the patellar tendon's slack length is 3 % off the finite"
    " differences', with backward differences alone. A derivative does not see jumps of the force that"
    " differences do; that this is all of it was not shown.",
    "exponent_one": _AMPLIFIED,
    "step_of_5_ms": _AMPLIFIED,
    "step_of_10_ms": _AMPLIFIED,
    "both_tendons_stiff": "On the spline: a sphere bears on every local minimum of its distance to the surface. In a"
    " groove nearly as round as the button a second one can come to be where the button is deep already, and what it"
    " stores is there at once: two wells 0.57 and 0.59 mm deep with a rise of 0.01 to 0.03 mm between them; where the"
    " second is found the contact stores 1.35 J instead of 0.74. The run says two frames later that energy was created."
    " Without inertia and in float32: across such a groove the tangent's stiffness is lost in rounding, and a fold is"
    " taken where float64 finds none; the patella snaps out of the groove.",
    "contact_hard": "By volume, in float32: a contact of 1e11 N/m^1.5 starts 0.2 um deep, where float32 places the"
    " button by steps of 4 nm; the energy is created by rounding, and the run says so.",
}


def limit_of(contact: str) -> Limit:
    """That of a kind of contact."""
    return LIMITS.get(contact, _NONE)
