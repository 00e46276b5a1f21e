"""The two running sums of the energy budget: work of guided bodies and prescribed tensions, and heat of damping.

The remainder, (T + V) - (T + V at the start) - work + heat, is the integrator's error; where it is negative, the method
itself dissipated energy. It tends to zero with the step.
"""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp

from pftwin.base.spatial import Scalar, Twist, Vec3
from pftwin.dynamics.state import State
from pftwin.model.effects.base import AggregateStiffness, Drag, Load


class Ledger(eqx.Module):
    """Running sums since the start [J]."""

    work: Scalar
    heat: Scalar

    def entered(
        self,
        before: State,
        after: State,
        loads: Sequence[Load],
        applied: Sequence[Scalar] | None,
        at: float,
        step: Scalar,
        looked: Twist | None = None,
    ) -> Ledger:
        """The ledger after one more step.

        Args:
            before: state at the step's start.
            after: at its end.
            loads: of the step.
            applied: the forces that the stiff terms had in the step, in the loads' order; None: those at mid-step.
            at: the instant of the loads' elastic forces within the step: 0 its start, 1 its end.
            step: its length [s].
            looked: the patella's velocities at which the loads were evaluated; by default those of `before`.
        """
        seen = Twist(before.velocity, before.spin) if looked is None else looked
        velocity, spin = _midpoint(before.velocity, after.velocity), _midpoint(before.spin, after.spin)
        work, heat, forces = self.work, self.heat, None if applied is None else iter(applied)
        for load in loads:
            if load.wrench is not None and load.energy is None:
                w = load.wrench
                work = work + step * (w.force.dot(velocity) + w.moment.dot(spin))
            if load.drag is not None:
                put_in, lost = _drag_power(load.drag, seen, before, after, Twist(velocity, spin), at)
                work, heat = work + step * put_in, heat + step * lost
            if load.bed is not None:
                put_in, lost = _bedded(load.bed, seen, Twist(velocity, spin), at, step)
                work, heat = work + step * put_in, heat + step * lost
            if load.heat is not None:
                heat = heat + step * load.heat
            for term in load.stiff:
                guided = term.rate + term.direction.dot(seen.linear) + term.moment.dot(seen.angular)
                rate = guided - term.direction.dot(velocity) - term.moment.dot(spin)
                elastic = term.elastic + (0.5 - at) * step * term.stiffness * rate
                force = term.force + (elastic - term.elastic) if forces is None else next(forces)
                work = work + step * jnp.sum(force * guided)
                heat = heat + step * jnp.sum((force - elastic) * rate)
        return Ledger(work, heat)


def _drag_power(drag: Drag, seen: Twist, before: State, after: State, mean: Twist, at: float) -> tuple[Scalar, Scalar]:
    """Power that the moving medium puts in and power lost, with the drag's force at the instant `at` of the step."""
    moving, turning = seen.linear - drag.velocity, seen.angular - drag.spin
    ahead = [
        start + at * (end - start) - own
        for start, end, own in ((before.velocity, after.velocity, moving), (before.spin, after.spin, turning))
    ]
    w = Drag(drag.translational, drag.rotational, *ahead).wrench()
    put_in = w.force.dot(moving) + w.moment.dot(turning)
    return put_in, -w.force.dot(mean.linear - moving) - w.moment.dot(mean.angular - turning)


def _bedded(bed: AggregateStiffness, seen: Twist, mean: Twist, at: float, step: Scalar) -> tuple[Scalar, Scalar]:
    """Power that the guided body under the foundation puts in and power lost, with the foundation's force as it is."""
    guided = jnp.concatenate([(seen.linear - bed.velocity).array(), (seen.angular - bed.spin).array()])
    twist = jnp.concatenate([mean.linear.array(), mean.angular.array()]) - guided
    elastic = bed.elastic - (0.5 - at) * step * bed.stiffness @ twist
    return bed.force @ guided, (elastic - bed.force) @ twist


def _midpoint(a: Vec3, b: Vec3) -> Vec3:
    return 0.5 * (a + b)
