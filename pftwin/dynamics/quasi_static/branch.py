"""The unknowns of a step without inertia: displacements of a pose, and the velocities that follow from them."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from pftwin.base.spatial import Scalar, Twist, Vec3, Wrench
from pftwin.dynamics.solve import Six, six
from pftwin.dynamics.state import Guide, State, System, displaced_state
from pftwin.dynamics.static_load import LEVER, Surroundings, components, look_around
from pftwin.model.effects.base import Instant


class Branch(NamedTuple):
    """The pose that displacements count from, and how velocities follow from displacements."""

    system: System
    origin: State  # d counts from here
    guide: Guide  # at the step's end
    step: Scalar
    rates: Scalar  # 1 in motion, 0 where everything stands still

    def span(self) -> Scalar:
        """The change of the displacement per change of the velocity [s]."""
        return (1 - self.origin.carried.share) * self.step

    def after(self, d: Six, past: Scalar | float = 1.0) -> State:
        """The state displaced by d, in metres and angles * lever, with the velocity that this means.

        Where `past` is 0, the last step's displacement counts for nothing.
        """
        displacement, share = displacement_of(d), past * self.origin.carried.share
        span = (1 - share) * self.step
        return displaced_state(
            self.origin,
            displacement,
            displacement.plus(-share, self.origin.carried.displacement).times(self.rates / span),
        )

    def instant(self, d: Six) -> Instant:
        """What effects look at there."""
        return self.guide.slowed(self.rates).instant(self.after(d).patella(), self.step)

    def held_instant(self, d: Six, held: Scalar | float) -> Instant:
        """The same as an implicit step sees it; where `held` is 1, contacts that open hold on as linear springs."""
        patella = self.after(d, 1 - held).patella()
        twist = Twist(patella.velocity, patella.spin)
        guide = self.guide.slowed(self.rates)
        return guide.instant(patella, 0.0, held * self.step, displacement_gain=self.step, twist=twist)

    def residual(self, d: Six) -> Six:
        """Unbalanced force, and moment / lever [N]."""
        loads, _ = self.system.loads(self.instant(d), self.origin.memories)
        return components(sum((load.total() for load in loads), start=Wrench.zero()))

    def look_around(self, d: Six, held: Scalar, neighbours: bool = True) -> Surroundings:
        """Loads at d and at its twelve neighbours; or at d alone, which has no tangent."""

        def instant_at(off: Six) -> Instant:
            return self.held_instant([a + b for a, b in zip(d, off, strict=True)], held)

        return look_around(self.system, instant_at, self.origin.memories, held, neighbours=neighbours)


def displacement_of(d: Six) -> Twist:
    """Displacement [m] and turn [rad]."""
    return Twist(Vec3(*d[:3]), (1 / LEVER) * Vec3(*d[3:]))


def components_of(displacement: Twist) -> Six:
    """The inverse of `displacement_of`."""
    return six(displacement.linear, LEVER * displacement.angular)


def norm(a: Six) -> Scalar:
    """Of six components."""
    return jnp.sqrt(sum((x * x for x in a[1:]), start=a[0] * a[0]))
