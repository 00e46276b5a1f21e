"""Cases that have to be refused, in words, before anything is computed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pftwin.mocap.poses import PoseSeries
from pftwin.studies.hard_cases.case import Case, Expected
from pftwin.studies.hard_cases.contacts import PATCHES
from pftwin.studies.hard_cases.ground import Ground
from pftwin.studies.hard_cases.knee import PATELLAR_TENDON, TROCHLEA, Knee, Law, flexed, swinging

TOPIC = "refused"


def _uneven() -> PoseSeries:
    plain = swinging()
    times = plain.times.copy()
    times[20:] += 0.02
    return PoseSeries(times, plain.positions, plain.quaternions)


def _not_finite() -> PoseSeries:
    plain = swinging()
    positions = plain.positions.copy()
    positions[3] = np.nan
    return PoseSeries(plain.times, positions, plain.quaternions)


def _not_unit() -> PoseSeries:
    plain = swinging()
    return PoseSeries(plain.times, plain.positions, 1.1 * plain.quaternions)


def _case(name: str, about: str, words: str, knee: Callable[[], Knee], **how: object) -> Case:
    return Case(name, TOPIC, about, knee, Expected(refusal=words), **how)  # pyright: ignore[reportArgumentType]


CASES = (
    _case("radius_negative", "A button of negative radius.", "positive", lambda: Knee(radius=-0.02)),
    _case("mass_zero", "A patella without mass.", "positive", lambda: Knee(mass=0.0)),
    _case(
        "restitution_zero", "Restitution 0: an infinite damping.", "positive", lambda: Knee(law=Law(restitution=0.0))
    ),
    _case(
        "restitution_above_one",
        "Restitution 1.2: every bounce would be higher than the last.",
        "at most 1",
        lambda: Knee(law=Law(restitution=1.2)),
    ),
    _case(
        "exponent_below_one",
        "Hertz exponent 0.5: an infinite stiffness where contact begins.",
        "at least 1",
        lambda: Knee(law=Law(exponent=0.5)),
    ),
    _case(
        "tendon_stiffness_negative",
        "A tendon that pushes.",
        "positive",
        lambda: Knee(patellar_tendon=replace(PATELLAR_TENDON, stiffness=-600.0)),
    ),
    _case(
        "tendon_stiffness_not_a_number",
        "A tendon's stiffness is not a number.",
        "not a finite number",
        lambda: Knee(patellar_tendon=replace(PATELLAR_TENDON, stiffness=float("nan"))),
    ),
    _case(
        "patch_without_extent",
        "A patch whose rectangle has no width.",
        "positive",
        lambda: Knee(ground=Ground(TROCHLEA.height, (0.024, 0.0))),
        contacts=PATCHES,
    ),
    _case(
        "motion_of_three_frames",
        "A motion of three frames.",
        "at least 4",
        lambda: Knee(tibia=lambda: flexed(np.full(3, 45.0))),
    ),
    _case("motion_uneven", "A motion with a gap of two frames in its times.", "evenly", lambda: Knee(tibia=_uneven)),
    _case("motion_not_finite", "A motion with a frame that is missing.", "not finite", lambda: Knee(tibia=_not_finite)),
    _case("motion_not_rotations", "Quaternions of length 1.1.", "unit quaternions", lambda: Knee(tibia=_not_unit)),
)
