"""Unknowns of a quasi-static step: displacements of a pose, and the velocities that follow from them."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from pftwin.base.spatial import Scalar, Twist, Vec3, Wrench
from pftwin.dynamics.solve import Six, six
from pftwin.dynamics.state import Guide, State, System, displaced_state
from pftwin.dynamics.static_load import LEVER, Surroundings, components, look_around
from pftwin.model.effects.base import Instant


class Branch(NamedTuple):
    """Origin of displacements, and the relation of velocities to displacements."""

    system: System
    origin: State  # state relative to which d is measured
    guide: Guide  # at the end of the step
    step: Scalar  # [s]
    rates: Scalar  # 1 in motion, 0 at rest

    def span(self) -> Scalar:
        """Derivative of the displacement with respect to the velocity [s]."""
        return (1 - self.origin.solver_state.share) * self.step

    def after(self, d: Six, past: Scalar | float = 1.0) -> State:
        """The state displaced by d [m, angles * lever], with the corresponding velocity.

        With `past` = 0, the displacement of the last step does not enter the velocity.
        """
        displacement, share = displacement_of(d), past * self.origin.solver_state.share
        span = (1 - share) * self.step
        return displaced_state(
            self.origin,
            displacement,
            displacement.plus(-share, self.origin.solver_state.displacement).times(self.rates / span),
        )

    def instant(self, d: Six) -> Instant:
        """The instant for effects at the displacement d."""
        return self.guide.slowed(self.rates).instant(self.after(d).patella(), self.step)

    def held_instant(self, d: Six, held: Scalar | float) -> Instant:
        """The same for an implicit step; with `held` = 1, opening contacts are linearised as springs that hold on."""
        patella = self.after(d, 1 - held).patella()
        twist = Twist(patella.velocity, patella.spin)
        guide = self.guide.slowed(self.rates)
        return guide.instant(patella, 0.0, held * self.step, displacement_gain=self.step, twist=twist)

    def residual(self, d: Six) -> Six:
        """Residual of the balance at the displacement d: force, and moment / lever [N]."""
        loads, _ = self.system.loads(self.instant(d), self.origin.memories)
        return components(sum((load.total() for load in loads), start=Wrench.zero()))

    def look_around(self, d: Six, held: Scalar, neighbours: bool = True) -> Surroundings:
        """Loads at d and, for the tangent, at its twelve neighbours."""

        def instant_at(off: Six) -> Instant:
            return self.held_instant([a + b for a, b in zip(d, off, strict=True)], held)

        return look_around(self.system, instant_at, self.origin.memories, held, neighbours=neighbours)


def displacement_of(d: Six) -> Twist:
    """Translation [m] and rotation [rad] of d [m, angles * lever]."""
    return Twist(Vec3(*d[:3]), (1 / LEVER) * Vec3(*d[3:]))


def components_of(displacement: Twist) -> Six:
    """Inverse of `displacement_of`."""
    return six(displacement.linear, LEVER * displacement.angular)


def norm(a: Six) -> Scalar:
    """Euclidean norm of six components."""
    return jnp.sqrt(sum((x * x for x in a[1:]), start=a[0] * a[0]))
