"""Static tension of a muscle of an OpenSim model, from its length and activation.

Fibre and tendon are in equilibrium at constant fibre length, so the force-velocity curve is not needed.
Sources: Millard et al. 2013, J Biomech Eng 135:021005; Thelen 2003, J Biomech Eng 125:70; OpenSim's classes for their
behaviour at the limits.
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
_LEAST_DAMPING = 0.001  # damping of Millard's fibre below which OpenSim treats it as undamped


class MuscleForce(NamedTuple):
    """Parameters of a muscle's static tension."""

    name: str
    strength: float  # maximum isometric force [N]
    fiber: float  # optimal fibre length [m]
    slack: float  # tendon slack length [m]
    pennation: float  # pennation angle at the optimal length [rad]
    most_pennation: float  # largest pennation angle [rad]
    rigid: bool  # whether the tendon is rigid
    least_activation: float
    curves: Curves

    @property
    def width(self) -> float:
        """Distance of the fibre's ends perpendicular to the tendon, which is constant [m]."""
        return self.fiber * np.sin(self.pennation)

    @property
    def shortest(self) -> float:
        """Smallest fibre length [m]."""
        return max(self.curves.shortest * self.fiber, self.width / np.sin(self.most_pennation))

    def tensions(self, lengths: Floats, activations: Floats) -> Floats:
        """Tension (n,) [N] at muscle-tendon lengths (n,) [m] and activations (n,) between 0 and 1."""
        pairs = zip(lengths, np.maximum(activations, self.least_activation), strict=True)
        return np.array([self.strength * self._pull(float(length), float(a)) for length, a in pairs])

    def _pull(self, length: float, activation: float) -> float:
        """Tendon force divided by the maximum isometric force.

        The fibre length is between its smallest value, at which the tendon's force exceeds the fibre's, and that at
        which the tendon is slack. If the fibre would have to be shorter, its smallest length is used.
        """
        least = self.shortest
        along = length - self.slack  # fibre length along the tendon if the tendon is slack
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
        """Force of a fibre of a length, along the tendon."""
        at = np.asarray(fiber / self.fiber)
        return float(activation * self.curves.active(at) + self.curves.passive(at)) * self._cosine(fiber)

    def _tendon(self, fiber: float, length: float) -> float:
        return float(self.curves.tendon(np.asarray((length - fiber * self._cosine(fiber)) / self.slack)))

    def _excess(self, fiber: float, length: float, activation: float) -> float:
        """Fibre force along the tendon minus tendon force."""
        return self._fiber(fiber, activation) - self._tendon(fiber, length)


def read_force(muscle: Element, defaults: Mapping[str, Element]) -> MuscleForce:
    """Reads a muscle's parameters from its element, else from the model's defaults, else OpenSim's.

    Raises InputError for an unsupported class or invalid parameters.
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
