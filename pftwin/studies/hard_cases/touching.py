"""Cases of contact: slow and hard touch, bounces, depth, stiffness, exponent, radius."""

from __future__ import annotations

from dataclasses import replace

from pftwin.dynamics.status import Status
from pftwin.studies.hard_cases.case import RELEASED, UNKNOWN, Case, Expected
from pftwin.studies.hard_cases.ground import Ground, mesh_on
from pftwin.studies.hard_cases.grounds import PLATE, VEE
from pftwin.studies.hard_cases.knee import ABSENT, PATELLAR_TENDON, RADIUS, Knee, Law, standing
from pftwin.surfaces.mesh import SurfaceMesh

FREE = Knee(
    ground=PLATE,
    center_of_mass=(0.0, 0.0, 0.0),
    quadriceps=ABSENT,
    patellar_tendon=ABSENT,
    tibia=standing,
    start=(0.0, 0.0, RADIUS),
)
WEIGHTLESS = (0.0, 0.0, 0.0)
TOPIC = "contact"


def _wide(ground: Ground) -> SurfaceMesh:
    """A mesh that goes on where a patch does: by its edge a small button would roll over the rim on its way to rest."""
    return mesh_on(replace(ground, half=(0.03, 0.03)))


def above(height: float, **changes: object) -> Knee:
    """A patella without tendons over a plate, with a gap below its button [m]."""
    knee = replace(FREE, **changes)  # pyright: ignore[reportArgumentType]
    return replace(knee, start=(0.0, 0.0, RADIUS + height))


def _dropped(name: str, about: str, knee: Knee, may: Status = RELEASED, **how: object) -> Case:
    expected = Expected(must=RELEASED, may=may, symmetric=True)
    return Case(name, TOPIC, about, lambda: knee, expected, released=True, **how)  # pyright: ignore[reportArgumentType]


CASES = (
    _dropped(
        "slow_touch",
        "Let go a nanometre above a plate, with no floor under Flores' approach speed: the damping factor grows without"
        " bound as the speed tends to 0, and the force has to stay finite.",
        above(1e-9, law=Law(floor=1e-9)),
    ),
    Case(
        "touch_without_force",
        TOPIC,
        "Exactly tangent, at rest, without weight: indentation 0 is on the law's kink. Nothing may push or move.",
        lambda: above(0.0, gravity=WEIGHTLESS),
        Expected(may=RELEASED, symmetric=True, still=True, force_at_end=False),
        released=True,
    ),
    Case(
        "far_from_everything",
        TOPIC,
        "Afloat 50 mm above a plate, without weight, tendons slack: no load at all, so no force, no motion and no"
        " division by the size of a load.",
        lambda: above(0.05, gravity=WEIGHTLESS),
        Expected(must=Status.NO_CONTACT, may=RELEASED, smooth=True, symmetric=True, still=True, force_at_end=False),
        released=True,
    ),
    Case(
        "start_without_contact",
        TOPIC,
        "The first frame touches nothing: the patella falls 20 mm onto the plate. Flags say so until it lands.",
        lambda: above(0.02, law=Law(restitution=0.3)),
        Expected(must=RELEASED | Status.NO_CONTACT, may=RELEASED, symmetric=True),
        released=True,
        step=5e-4,
    ),
    _dropped(
        "bounce_to_rest",
        "Dropped by 3 mm with a restitution of 0.5: ever shorter bounces (Zeno's) that end in rest, and leave"
        " the button"
        " loaded with the weight.",
        above(0.003, law=Law(restitution=0.5)),
    ),
    _dropped(
        "restitution_near_zero",
        "Restitution 0.001 makes the damping some 1,600 times what it is at 0.5: stiff in the velocity, and no bounce.",
        above(0.003, law=Law(restitution=1e-3)),
    ),
    _dropped(
        "restitution_one",
        "Restitution exactly 1: no damping at all. No bounce may be higher than the one before it.",
        above(0.003, law=Law(restitution=1.0)),
        step=2e-4,
    ),
    _dropped(
        "deep_start",
        "Starts 1.2 mm inside the plate, with 30 times its weight's work stored: thrown out at 8 m/s, flagged as"
        " too deep,"
        " and without energy from nowhere.",
        above(-0.0012),
        RELEASED | UNKNOWN,
        step=1e-4,
    ),
    Case(
        "two_facet_chatter",
        TOPIC,
        "Dropped off the middle into a groove, nearly without loss: it rattles from facet to facet, contacts"
        " come and go"
        " one by one and both at once.",
        lambda: replace(FREE, ground=VEE, law=Law(restitution=0.95), start=(0.0, 0.004, RADIUS + 0.009)),
        Expected(must=RELEASED, may=RELEASED),
        released=True,
        step=2e-4,
    ),
    Case(
        "contact_soft",
        TOPIC,
        "Contact stiffness 1e5 N/m^1.5: millimetres of indentation, beyond what a small deformation is, and flagged.",
        # Drawn distally by a shorter tendon: it sinks in so far that it would slide over the ground's upper end.
        lambda: Knee(law=Law(stiffness=1e5), patellar_tendon=replace(PATELLAR_TENDON, slack_length=0.062)),
        Expected(must=Status.DEEP_INDENTATION, smooth=True),
    ),
    Case(
        "contact_hard",
        TOPIC,
        "Contact stiffness 1e11 N/m^1.5: a micrometre of indentation, vibrations of some 10 kHz, steps of a"
        " millisecond.",
        lambda: Knee(law=Law(stiffness=1e11)),
        Expected(),
    ),
    Case(
        "exponent_one",
        TOPIC,
        "Hertz exponent 1, a linear spring: its slope jumps at first touch, and d^(p-1) is 0^0 there.",
        lambda: Knee(law=Law(stiffness=2e6, exponent=1.0)),
        Expected(smooth=True),
    ),
    Case(
        "exponent_two",
        TOPIC,
        "Hertz exponent 2: the slope vanishes where contact begins.",
        lambda: Knee(law=Law(stiffness=2e10, exponent=2.0)),
        Expected(smooth=True),
    ),
    Case(
        "patella_of_1_g",
        TOPIC,
        "A patella of 1 g: contact and tendons are a hundred times stiffer against its inertia than usual.",
        lambda: Knee(mass=1e-3),
        Expected(),
    ),
    Case(
        "patella_of_1_kg",
        TOPIC,
        "A patella of 1 kg, heavier than what the tendons can hold for long.",
        lambda: Knee(mass=1.0),
        Expected(),
    ),
    Case(
        "button_of_1_mm",
        TOPIC,
        "A button of 1 mm radius: a way of 0.25 mm in one step is too long for it, and a twentieth of its radius deep."
        " It comes to rest 40 mm from where it is put.",
        lambda: Knee(radius=1e-3, center=(0.0, 0.0, RADIUS * -1 + 1e-3), mesh=_wide),
        Expected(may=Status.STEP_TOO_LONG),
        step=2e-4,
    ),
    Case(
        "button_of_1_m",
        TOPIC,
        "A button of 1 m radius, nearly a plane: it touches the groove's rims, and its contact points hurry.",
        lambda: Knee(radius=1.0, center=(0.0, 0.0, 1.0 - RADIUS)),
        Expected(may=Status.STEP_TOO_LONG),
    ),
)
