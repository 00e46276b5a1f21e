"""Cases of tendons: slack, jerking taut, without length, pulling the other way, soft and stiff."""

from __future__ import annotations

from dataclasses import replace

from pftwin.dynamics.status import Status
from pftwin.studies.hard_cases.case import RELEASED, Case, Expected
from pftwin.studies.hard_cases.grounds import VEE
from pftwin.studies.hard_cases.knee import PATELLAR_TENDON, QUADRICEPS, RADIUS, Knee, Strand
from pftwin.studies.hard_cases.touching import FREE, WEIGHTLESS

TOPIC = "tendons"
_HIGH = (0.0, 0.0, 0.2)  # where a patella floats free of the plate [m]


def _along_x(slack: float, origin: float, damping_time: float = 0.0) -> Strand:
    """A tendon from the patella's own centre to a point beside it, at the height of `_HIGH`."""
    return Strand(300, slack, (0.0, 0.0, 0.0), (origin, 0.0, _HIGH[2]), damping_time)


def _afloat(strand: Strand) -> Knee:
    return replace(FREE, gravity=WEIGHTLESS, quadriceps=strand, start=_HIGH)


CASES = (
    Case(
        "tendons_slack",
        TOPIC,
        "Both tendons hang slack and the patella lies in a groove by its weight alone: their forces and all derivatives"
        " by them are exactly 0, and along the groove nothing holds it.",
        lambda: replace(FREE, ground=VEE, start=(0.0, 0.0, RADIUS + 0.0035)),
        Expected(may=RELEASED, symmetric=True, force_at_end=True),
        released=True,
    ),
    Case(
        "tendon_jerks_taut",
        TOPIC,
        "Falls freely by 10 mm until a tendon of 5e4 N/m without damping goes taut with a jerk, and is thrown back.",
        lambda: replace(
            FREE,
            start=_HIGH,
            quadriceps=Strand(5e4, 0.05, (0.0, 0.0, 0.0), (0.0, 0.0, _HIGH[2] + 0.04), 0.0),
        ),
        Expected(must=RELEASED | Status.NO_CONTACT, may=RELEASED, symmetric=True, force_at_end=False),
        released=True,
        step=5e-4,
    ),
    Case(
        "tendon_without_length",
        TOPIC,
        "A tendon whose two ends coincide at the start, slack: a direction of length 0, and no division by it.",
        lambda: _afloat(_along_x(0.02, 0.0)),
        Expected(must=Status.NO_CONTACT, may=RELEASED, symmetric=True, still=True, force_at_end=False),
        released=True,
    ),
    Case(
        "tendon_reversed",
        TOPIC,
        "A tendon of nearly no slack length pulls the patella straight through its own origin: length 0 is"
        " passed at full"
        " speed, and the direction turns round within one step.",
        lambda: _afloat(_along_x(1e-6, 0.01)),
        Expected(must=RELEASED | Status.NO_CONTACT, may=RELEASED, symmetric=True, force_at_end=False),
        released=True,
    ),
    Case(
        "tendon_soft",
        TOPIC,
        "Tendons of 100 N/m: they hardly hold the patella against its weight.",
        # Drawn distally by its slack lengths: else it rests 14 mm past the ground's upper end, if it rests at all, on
        # what the kind of surface makes of the ground there. Over a cylinder that goes round the axis, to below it.
        lambda: Knee(
            quadriceps=replace(QUADRICEPS, stiffness=1e2, slack_length=0.165),
            patellar_tendon=replace(PATELLAR_TENDON, stiffness=1e2, slack_length=0.04),
        ),
        Expected(smooth=True),
    ),
    Case(
        "tendon_stiff",
        TOPIC,
        "A patellar tendon of 5e5 N/m, nearly a rod, as stiff against the patella as the contact, with a damping of"
        " 5,000 N s/m.",
        lambda: Knee(patellar_tendon=replace(PATELLAR_TENDON, stiffness=5e5)),
        Expected(smooth=True),
    ),
    Case(
        "both_tendons_stiff",
        TOPIC,
        "Quadriceps of 5e4 and patellar tendon of 5e5 N/m without any damping: three stiff directions fight.",
        lambda: Knee(
            quadriceps=replace(QUADRICEPS, stiffness=5e4, slack_length=0.16, damping_time=0.0),
            patellar_tendon=replace(PATELLAR_TENDON, stiffness=5e5, damping_time=0.0),
        ),
        Expected(),
        step=5e-4,
    ),
)
