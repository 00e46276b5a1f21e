"""Straight-line springs nearest to the rig's stiffening ones over the forces that occur.

The twin's springs follow F = K (L - L0); those of the plant that makes the rig's measurements stiffen with stretch
(`pftwin.rig.geometry.STIFFENING`), F = K s (1 + 0.05 s / (L0 / 4)) with the stretch s = L - L0. So the twin cannot
match the measurements with the plant's own K and L0: the line nearest to the plant's curve is steeper and starts later.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.model.effects.line_elements import ElasticLine
from pftwin.rig.geometry import STIFFENING

QUADRICEPS, PATELLAR_TENDON = "quadriceps", "patellar_tendon"


class StraightSpring(NamedTuple):
    """A spring F = K (L - L0)."""

    stiffness: float  # K [N/m]
    slack_length: float  # L0 [m]
    misfit: float  # root mean square distance of the fitted forces from the line [N]


def straight_line(lengths: ArrayLike, forces: ArrayLike) -> StraightSpring:
    """The line nearest to forces (n,) [N] over lengths (n,) [m], by least squares in force.

    Missing forces (NaN) and those of a slack spring (0) are omitted. Raises InputError for fewer than two different
    lengths under load, and for forces that do not grow with length.
    """
    x, f = np.asarray(lengths, dtype=np.float64), np.asarray(forces, dtype=np.float64)
    taut = np.isfinite(x) & np.isfinite(f) & (f > 0)
    x, f = x[taut], f[taut]
    if x.size == 0 or np.ptp(x) == 0:
        raise InputError("no line through forces at one length", where="forces", expected="two lengths under load")
    off = x - x.mean()
    slope = float(off @ f / (off @ off))
    if slope <= 0:
        raise InputError("forces fall as the spring is stretched", where="forces", expected="those of a spring")
    slack = float(x.mean() - f.mean() / slope)
    return StraightSpring(slope, slack, float(np.sqrt(np.mean((f - slope * (x - slack)) ** 2))))


def stretch_under(force: ArrayLike, stiffness: float, slack_length: float, stiffening: float | None = None) -> Floats:
    """Stretch [m] at which a spring of the plant has a force [N]: the positive root of its law."""
    more = (STIFFENING if stiffening is None else stiffening) / (0.25 * slack_length)
    if more == 0:
        return np.asarray(force, dtype=np.float64) / stiffness
    return (np.sqrt(1 + 4 * more * np.asarray(force, dtype=np.float64) / stiffness) - 1) / (2 * more)


class Pull(NamedTuple):
    """A spring with its recorded lengths and forces."""

    spring: ElasticLine  # the twin's, with nominal parameters
    lengths: Floats  # between the twin's attachments (n,) [m]
    forces: Floats  # without the damper's share (n,) [N]


def recorded_pulls(case: int) -> dict[str, Pull]:
    """Lengths and elastic forces of both springs in a case of the rig, by the springs' names."""
    from pftwin import rig
    from pftwin.rig.cases import recording

    scene, recorded = rig.case(case), recording(case)
    measured, patella = recorded.measured, recorded.patella
    bodies = {"femur": recorded.femur, "tibia": recorded.tibia}
    pulls = {}
    for name, forces in ((QUADRICEPS, measured.femoral_spring_force), (PATELLAR_TENDON, measured.tibial_spring_force)):
        spring: Any = scene.effect(name)  # the rig's spring, which has a damper
        body = bodies[spring.body]
        origin = body.positions + body.matrices() @ np.asarray(spring.origin.array())
        insertion = patella.positions + patella.matrices() @ np.asarray(spring.insertion.array())
        lengths = np.linalg.norm(origin - insertion, axis=1)
        damper = float(spring.damping) * np.gradient(lengths, measured.times)
        pulls[name] = Pull(spring, lengths, np.asarray(forces) - damper)
    return pulls


def nearest_line(pull: Pull) -> StraightSpring:
    """The line nearest to the law of the plant's spring over the recorded forces, each as often as it occurs."""
    stiffness, slack = float(pull.spring.stiffness), float(pull.spring.slack_length)
    return straight_line(slack + stretch_under(pull.forces, stiffness, slack), pull.forces)
