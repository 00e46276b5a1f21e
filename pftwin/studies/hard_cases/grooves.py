"""Cases of surfaces: edges, ridges, grooves too flat, too steep or too narrow, and equilibria that hardly are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pftwin.dynamics.status import Status
from pftwin.studies.hard_cases.case import RELEASED, Case, Expected
from pftwin.studies.hard_cases.contacts import PATCHES
from pftwin.studies.hard_cases.ground import Ground
from pftwin.studies.hard_cases.grounds import NARROW, PLATE, RIDGE, SHALLOW, SHOULDERS, SMALL_PATCH, STEEP
from pftwin.studies.hard_cases.knee import PATELLAR_TENDON, QUADRICEPS, RADIUS, TROCHLEA, Knee, Strand, standing
from pftwin.studies.hard_cases.touching import FREE

TOPIC = "surfaces"
_MIDDLE = {
    "quadriceps": replace(QUADRICEPS, origin=(0.22, 0.0, 0.035)),
    "patellar_tendon": replace(PATELLAR_TENDON, origin=(-0.07, 0.0, 0.045)),
    "center_of_mass": (0.001, 0.0, 0.004),
}


def _level(ground: Ground, height: float, pull: float = 0.02, **changes: object) -> Knee:
    """A patella on a level ground between two tendons that pull it down a little, all in the middle plane."""
    forward = Strand(156, 0.06, (0.02, 0, -0.008), (0.10, 0.0, RADIUS - pull))
    back = Strand(156, 0.06, (-0.02, 0, -0.008), (-0.10, 0.0, RADIUS - pull))
    start = (0.0, 0.0, RADIUS + height)
    knee = replace(
        FREE, ground=ground, quadriceps=forward, patellar_tendon=back, start=start, center_of_mass=(0, 0, 0.0)
    )
    return replace(knee, **changes)  # pyright: ignore[reportArgumentType]


def _on_the_ridge(aside: float) -> Knee:
    """A patella that nothing but its weight presses on a crest, so far beside it [m]."""
    return replace(FREE, ground=RIDGE, start=(0.0, aside, RADIUS - 0.0036))


def _dislocating(pull: float) -> Knee:
    """The quadriceps' origin moved laterally so far that the patella leaves the groove [m]."""
    return Knee(quadriceps=replace(QUADRICEPS, origin=(0.18, pull, 0.03), stiffness=400))


CASES = (
    Case(
        "dislocation_across_the_edge",
        TOPIC,
        "Pulled sideways over the groove's edge and beyond the fitted rectangle, onto the patch's continuation:"
        " no jump,"
        " and flagged from where it is no surface any more.",
        lambda: replace(
            _level(PLATE, 0.0),
            ground=Ground(TROCHLEA.height, (0.012, 0.012)),
            quadriceps=Strand(600, 0.02, (0, 0, -0.008), (0.0, 0.06, -0.01)),
            start=(0.0, 0.002, RADIUS + 0.003),
        ),
        Expected(must=Status.LEFT_PATCH | RELEASED, may=RELEASED),
        released=True,
        contacts=PATCHES,
    ),
    Case(
        "fall_back_into_the_groove",
        TOPIC,
        "Let go above the lateral facet of a steep groove: it slides down and meets the medial facet while the lateral"
        " contact still bears, and rattles over the bottom, which is too narrow for it.",
        lambda: replace(FREE, ground=STEEP, radius=0.008, start=(0.0, 0.008, 0.0525), tibia=standing),
        Expected(must=RELEASED, may=RELEASED),
        released=True,
        step=5e-4,
    ),
    Case(
        "wedged_high_riding",
        TOPIC,
        "Pulled hard into a groove with walls of 70 deg: wedged between two facets whose normals are nearly"
        " opposite, so"
        " each bears far more than the pull.",
        lambda: _level(STEEP, 0.012, 0.06),
        Expected(smooth=True, symmetric=True),
    ),
    Case(
        "sphere_on_a_ridge",
        TOPIC,
        "Exactly on the crest of a ridge, no tendon holds it and everything is symmetric: unstable, but nothing tells"
        " left from right, so it has to stay in the middle plane.",
        lambda: _on_the_ridge(0.0),
        Expected(may=RELEASED, symmetric=True),
        released=True,
    ),
    Case(
        "ridge_left_of_the_crest",
        TOPIC,
        "A micrometre beside the crest of the same ridge: it falls to that side, growing from a micrometre by e in"
        " every 0.08 s.",
        lambda: _on_the_ridge(-1e-6),
        Expected(may=RELEASED),
        released=True,
    ),
    Case(
        "several_equilibria",
        TOPIC,
        "A shallow hollow between two shoulders, beyond which it falls off: from a start near the crest the search has"
        " to take the equilibrium downhill of it, and stay.",
        lambda: replace(_level(SHOULDERS, 0.0), start=(0.0, 0.012, RADIUS + 0.004)),
        Expected(smooth=True),
        contacts=PATCHES,
    ),
    Case(
        "near_singular_equilibrium",
        TOPIC,
        "A groove that hardly rises and tendons that hardly hold: an equilibrium whose stiffness across is a"
        " thousandth of"
        " that along, and moves far for little.",
        lambda: _level(SHALLOW, 0.0, 0.002),
        Expected(symmetric=True),
    ),
    Case(
        "groove_nearly_flat",
        TOPIC,
        "Facets that rise by 1 deg: medial and lateral contact are one, or nearly, at every step.",
        # Long enough that it lies on it: flat, the trochlea's own rectangle ends 13 mm short of its equilibrium.
        lambda: replace(Knee(), ground=replace(TROCHLEA, height=SHALLOW.height, half=(0.06, 0.03))),
        Expected(),
    ),
    Case(
        "groove_nearly_vertical",
        TOPIC,
        "Facets of 80 deg: a polynomial over a plane is at its worst, curvatures at the bottom are sharper than the"
        " button, and normals turn by 160 deg within millimetres.",
        lambda: _level(
            Ground(lambda u, v: np.sqrt(v**2 + 0.004**2) * np.tan(np.radians(80)), (0.02, 0.012)), 0.06, 0.06
        ),
        Expected(symmetric=True, may=Status.STEP_TOO_LONG),
        contacts=PATCHES,
    ),
    Case(
        "button_larger_than_the_groove",
        TOPIC,
        "A groove of 55 deg facets, 2 mm round at the bottom: the button rests on its flanks and never sees the"
        " bottom.",
        lambda: _level(NARROW, 0.02, 0.04),
        Expected(smooth=True, symmetric=True),
        contacts=PATCHES,
    ),
    Case(
        "patch_barely_larger_than_the_contact",
        TOPIC,
        "A patch of 8 by 8 mm below a button of 22 mm radius: contacts lie on its edge, and the search for"
        " facets reaches"
        " beyond it on all sides.",
        lambda: _level(SMALL_PATCH, 0.002, 0.02),
        Expected(symmetric=True),
        contacts=PATCHES,
    ),
    Case(
        "rest_in_the_groove",
        TOPIC,
        "An equilibrium under a tibia that stands: nothing may creep from it, whatever the step.",
        lambda: Knee(tibia=standing),
        Expected(smooth=True, still=True),
    ),
)
