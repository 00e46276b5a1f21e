"""How hard a muscle of an OpenSim model pulls at rest, from its length and its activation.

Fibre and tendon are in equilibrium, and the fibre neither shortens nor lengthens: no force-velocity curve is asked.
Sources: Millard et al. 2013, J Biomech Eng 135:021005; Thelen 2003, J Biomech Eng 125:70; OpenSim's classes for what
they do at the ends of their ranges.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from pftwin.base.arrays import Floats
from pftwin.base.errors import InputError
from pftwin.files.interchange.osim_document import Element
from pftwin.files.interchange.osim_muscle_curves import Curves, Properties, millard, thelen

MILLARD, THELEN = "Millard2012EquilibriumMuscle", "Thelen2003Muscle"
MUSCLES = (MILLARD, THELEN)
_LEAST_DAMPING = 0.001  # of Millard's fibre; with less OpenSim takes it for none


class MuscleForce(NamedTuple):
    """What the tension of a muscle at rest follows from."""

    name: str
    strength: float  # greatest isometric force [N]
    fiber: float  # its optimal length [m]
    slack: float  # of the tendon [m]
    pennation: float  # at the optimal length [rad]
    most_pennation: float  # [rad]
    rigid: bool  # whether the tendon does not stretch
    least_activation: float
    curves: Curves

    @property
    def width(self) -> float:
        """Distance of the fibre's ends across the tendon, which stays as it is [m]."""
        return self.fiber * np.sin(self.pennation)

    @property
    def shortest(self) -> float:
        """The fibre's least length [m]."""
        return max(self.curves.shortest * self.fiber, self.width / np.sin(self.most_pennation))

    def tensions(self, lengths: Floats, activations: Floats) -> Floats:
        """Tension (n,) [N] at lengths of the whole muscle (n,) [m] and activations (n,) between 0 and 1."""
        pairs = zip(lengths, np.maximum(activations, self.least_activation), strict=True)
        return np.array([self.strength * self._pull(float(length), float(a)) for length, a in pairs])

    def _pull(self, length: float, activation: float) -> float:
        """The tendon's force by the greatest isometric one.

        The fibre's length lies between its least, at which the tendon pulls harder than the fibre, and that at which
        the tendon is slack. Where the fibre would have to be shorter than that, its least length decides.
        """
        least = self.shortest
        along = length - self.slack  # of the fibre along the tendon, where that is slack
        longest = float(np.hypot(self.width, along)) if along > 0 else 0.0
        if longest <= least:
            return 0.0
        strongest = self._fiber(longest, activation)  # with the tendon as short as it can be
        if self.rigid or self._excess(longest, length, activation) <= 0:
            return strongest
        if self._excess(least, length, activation) >= 0:
            return self._tendon(least, length)
        found = brentq(self._excess, least, longest, args=(length, activation), xtol=1e-12, rtol=1e-12)
        return self._tendon(float(found), length)  # pyright: ignore[reportArgumentType]

    def _cosine(self, fiber: float) -> float:
        sine = min(self.width / fiber, float(np.sin(self.most_pennation))) if fiber > 0 else 0.0
        return float(np.sqrt(1 - sine**2))

    def _fiber(self, fiber: float, activation: float) -> float:
        """Force of a fibre of that length along the tendon."""
        at = np.asarray(fiber / self.fiber)
        return float(activation * self.curves.active(at) + self.curves.passive(at)) * self._cosine(fiber)

    def _tendon(self, fiber: float, length: float) -> float:
        return float(self.curves.tendon(np.asarray((length - fiber * self._cosine(fiber)) / self.slack)))

    def _excess(self, fiber: float, length: float, activation: float) -> float:
        """By how much the fibre pulls harder than the tendon."""
        return self._fiber(fiber, activation) - self._tendon(fiber, length)


def read_force(muscle: Element, defaults: Mapping[str, Element]) -> MuscleForce:
    """What a muscle's element says of its force; what it does not say is as in the model's defaults, then OpenSim's.

    Raises:
        InputError: a muscle of another class; numbers that no muscle has.
    """
    if muscle.tag not in MUSCLES:
        found = f"no force follows from the activation of a <{muscle.tag}> {muscle.name!r}"
        raise InputError(found, where=muscle.where, expected=f"one of: {', '.join(MUSCLES)}")
    held = [muscle, *([defaults[muscle.tag]] if muscle.tag in defaults else [])]
    said = Properties(held)
    strength, fiber, slack, pennation, most, least, damping = said.numbers(
        max_isometric_force=1000.0,
        optimal_fiber_length=0.1,
        tendon_slack_length=0.2,
        pennation_angle_at_optimal=0.0,
        maximum_pennation_angle=float(np.arccos(0.1)),
        minimum_activation=0.01,
        fiber_damping=0.1,
    )
    said.expect(min(strength, fiber, slack) > 0, "a positive force, and positive lengths of fibre and tendon")
    said.expect(0 <= pennation < most <= np.pi / 2, "a pennation below its greatest one, and that at most pi / 2")
    said.expect(0 <= least < 1, "a minimum activation of 0 or more and below 1")
    rigid = said.flag("ignore_tendon_compliance")
    if muscle.tag == THELEN:
        said.expect(not rigid, "a tendon that stretches, as OpenSim wants of this class")
        curves = thelen(held)
    else:
        curves = millard(held, damped=rigid or damping >= _LEAST_DAMPING)
    return MuscleForce(muscle.name, strength, fiber, slack, pennation, most, rigid, least, curves)
